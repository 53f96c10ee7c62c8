"""What every camera driver must do, as checks: of emulated cameras in the tests, of real ones by `capture doctor --pictures`.

    subject = Subject(lambda settings: MyCamera(settings, serial="7"), CameraSettings(width=640, height=480))
    broken = check(subject)  # clause -> what is wrong; empty where the driver keeps the contract

A clause opens and closes the camera itself, so that none depends on another.
"""

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.drivers.protocols import Camera, Image
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.datasets.camera_model import Camera as Intrinsics
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.imaging.region import Region

SHARE, STEP_US, GAIN_DB = 0.02, 35.0, 0.1
"""How far exposure (relative, or half a step of the sensor) and gain may be from what was asked for."""
QUICK_S = 0.5  # longest time to make a camera without opening it
IMPOSSIBLE_US = 1e13  # no camera exposes for a third of a year
GREY = ("mono8", "mono12")
KEYS = ("driver", "model", "serial", "exposure_us", "gain_db", "pixel_format", "sensor", "state")
"""What each description holds."""


@dataclass(frozen=True)
class Subject:
    """A camera to check."""

    make: Callable[[CameraSettings], Camera]
    """Makes a camera that is not open; is called several times."""
    settings: CameraSettings
    """Settings that the camera takes."""
    rejected: tuple[dict[str, Any], ...] = ({"width": 7_000_000, "height": 16},)
    """Changes to the settings that it must refuse."""
    other_exposure_us: float | None = None
    """Another exposure time that it takes; None where it takes none (`exposure_us` in `camera.leave`)."""


class Broken(KoalaError):
    """A driver does not keep a clause of the contract."""


def require(good: bool, what: str, why: object = "") -> None:
    """Raise Broken unless `good`."""
    if not good:
        raise Broken(what, why=str(why))


def check(subject: Subject) -> dict[str, str]:
    """Every clause that the camera breaks, and how; an error of the driver where none belongs breaks it too."""
    broken = {}
    for name, clause in CONTRACT.items():
        try:
            clause(subject)
        except Exception as error:  # whatever a driver does wrong
            broken[name] = str(error) if isinstance(error, KoalaError) else f"{type(error).__name__}: {error}"
    return broken


def a_picture_has_the_size_and_values_asked_for(subject: Subject) -> None:
    """(height, width, 3), or 1 of grey sensors; 8 bits, or 16 of formats with 12, with the raw values beside it."""
    wanted = subject.settings
    with subject.make(wanted) as camera:
        image = camera.grab()
    channels = 1 if wanted.pixel_format in GREY else 3
    require(image.pixels.shape == (wanted.height, wanted.width, channels), "picture has another shape", image.pixels.shape)
    kind = np.uint16 if wanted.keeps_raw else np.uint8
    require(image.pixels.dtype == kind, f"picture is not of {np.dtype(kind).name}", image.pixels.dtype)
    require((image.raw is not None) == wanted.keeps_raw, "raw values are there just where the format keeps them")


def a_picture_says_when_it_was_taken(subject: Subject) -> None:
    """`host_time_ns` lies within the call that took it; `device_ticks` do not fall."""
    with subject.make(subject.settings) as camera:
        seen = [_timed(camera) for _ in range(2)]
    for begun, image, ended in seen:
        require(begun <= image.host_time_ns <= ended, "host_time_ns is not within the call", image.host_time_ns)
    (_, first, _), (_, second, _) = seen
    require(first.host_time_ns < second.host_time_ns, "the second picture is not later", second.host_time_ns)
    require(0 <= first.device_ticks <= second.device_ticks, "device_ticks fall", (first.device_ticks, second.device_ticks))


def a_picture_keeps_its_values(subject: Subject) -> None:
    """The next picture is written to other memory."""
    with subject.make(subject.settings) as camera:
        image = camera.grab()
        kept = [None if part is None else part.copy() for part in (image.pixels, image.raw, image.depth)]
        camera.grab()
        pairs = zip((image.pixels, image.raw, image.depth), kept, strict=True)
        same = [part is None or was is None or np.array_equal(part, was) for part, was in pairs]
    require(all(same), "the next picture changed an earlier one")


def exposure_and_gain_are_those_asked_for(subject: Subject) -> None:
    """As read back from the camera; where it takes none, as the trajectory states them.

    Where binning adds up pixels, the exposure is shorter by the description's `binning_gain`.
    """
    wanted = subject.settings
    with subject.make(wanted) as camera:
        image, gain = camera.grab(), camera.description().get("binning_gain", 1)
    require(_near(image.exposure_us, wanted.exposure_us / gain), "exposure is another", f"{image.exposure_us} us")
    require(abs(image.gain_db - wanted.gain_db) <= GAIN_DB, "gain is another", f"{image.gain_db} dB")


def another_exposure_is_taken_up(subject: Subject) -> None:
    """From the next picture on, and back again; a camera that takes none says so."""
    wanted, other = subject.settings.exposure_us, subject.other_exposure_us
    with subject.make(subject.settings) as camera:
        if other is None:
            _refused(lambda: camera.set_exposure(wanted / 2), "a camera without exposure takes one")
            return
        for exposure_us in (other, wanted):
            camera.set_exposure(exposure_us)
            image = camera.grab()
            require(_near(image.exposure_us, exposure_us), "exposure was not taken up", f"{image.exposure_us} us")
            require(_near(camera.description()["exposure_us"], exposure_us), "the description has another exposure")


def an_impossible_exposure_changes_nothing(subject: Subject) -> None:
    """It is refused with a remedy, and the camera goes on with the old one."""
    with subject.make(subject.settings) as camera:
        _refused(lambda: camera.set_exposure(IMPOSSIBLE_US), f"an exposure of {IMPOSSIBLE_US:g} us is taken")
        image, gain = camera.grab(), camera.description().get("binning_gain", 1)
    require(_near(image.exposure_us, subject.settings.exposure_us / gain), "a refused exposure was taken up", image.exposure_us)


def the_description_can_be_stored(subject: Subject) -> None:
    """It is JSON without NaN, names driver, model and serial number, and its region, if any, has the size of the pictures."""
    wanted = subject.settings
    with subject.make(wanted) as camera:
        said = camera.description()
    missing = [key for key in KEYS if key not in said]
    require(not missing, "the description is not complete", ", ".join(missing))
    json.dumps(said, allow_nan=False)
    require(isinstance(said["driver"], str) and bool(said["driver"]) and bool(said["model"]), "it does not name the camera")
    if "region" in said:
        region = Region.from_json(said["region"], where="region")
        require((region.width, region.height) == (wanted.width, wanted.height), "region has another size", region)


def depth_belongs_to_its_picture(subject: Subject) -> None:
    """Where there is depth, it is (height, width) of 16 bits, and the description says how to read it; else it says nothing."""
    with subject.make(subject.settings) as camera:
        depth, said = camera.grab().depth, camera.description().get("depth")
    require((depth is None) == (said is None), "depth and its description are not both there")
    if depth is None or said is None:
        return
    seen = Intrinsics.from_json(said["camera"], where="depth.camera")
    require(depth.dtype == np.uint16 and depth.shape == (seen.height, seen.width), "depth has another shape", depth.shape)
    require(0 < said["unit_m"] < 1, "unit_m is no unit of depth", said["unit_m"])
    turn = np.array(said["camera_from_depth"])[:3, :3]
    require(np.allclose(turn @ turn.T, np.eye(3), atol=1e-4), "camera_from_depth is no pose")


def a_rejected_setting_leaves_the_camera_free(subject: Subject) -> None:
    """Opening raises a CaptureError with a remedy, and the next one can open it."""
    for changed in subject.rejected:
        bad = subject.make(subject.settings.model_copy(update=changed))
        _refused(bad.__enter__, f"{changed} is taken")
    with subject.make(subject.settings) as camera:
        camera.grab()


def it_can_be_closed_twice_and_opened_again(subject: Subject) -> None:
    """And says that it is closed where it is used in between."""
    camera = subject.make(subject.settings)
    for _ in range(2):
        with camera:
            camera.grab()
        camera.__exit__(None, None, None)
        _refused(camera.grab, "a closed camera takes a picture")


def making_one_touches_nothing(subject: Subject) -> None:
    """It takes no time, and does not disturb one that is open."""
    with subject.make(subject.settings) as camera:
        begun = time.monotonic()
        subject.make(subject.settings)
        require(time.monotonic() - begun < QUICK_S, "making a camera takes time: the constructor connects")
        camera.grab()


CONTRACT: dict[str, Callable[[Subject], None]] = {
    clause.__name__: clause
    for clause in (
        a_picture_has_the_size_and_values_asked_for,
        a_picture_says_when_it_was_taken,
        a_picture_keeps_its_values,
        exposure_and_gain_are_those_asked_for,
        another_exposure_is_taken_up,
        an_impossible_exposure_changes_nothing,
        the_description_can_be_stored,
        depth_belongs_to_its_picture,
        a_rejected_setting_leaves_the_camera_free,
        it_can_be_closed_twice_and_opened_again,
        making_one_touches_nothing,
    )
}
"""All clauses by name."""


def _timed(camera: Camera) -> tuple[int, Image, int]:
    begun = time.monotonic_ns()
    return begun, camera.grab(), time.monotonic_ns()


def _near(found: float, wanted: float) -> bool:
    return math.isfinite(found) and abs(found - wanted) <= max(SHARE * wanted, STEP_US / 2)


def _refused(act: Callable[[], object], what: str) -> None:
    """`act` must raise a CaptureError that says what to do."""
    try:
        act()
    except CaptureError as error:
        require(bool(error.remedy), "an error without a remedy", error)
        return
    raise Broken(what, remedy="raise a CaptureError")
