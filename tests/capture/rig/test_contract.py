"""Every driver keeps the contract through its vendor's own library, and the contract notices each way of breaking it."""

import os
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from koala3d.capture.drivers.cameras.basler import Basler
from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.drivers.measurements import Image
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings, load_trajectory
from koala3d.capture.rig import contract
from koala3d.capture.rig.cameras import camera_for
from koala3d.capture.rig.contract import CONTRACT, KEYS, Broken, Subject, check
from koala3d.datasets.imaging import images

SMALL = CameraSettings(width=64, height=48, binning=4, exposure_us=2000)
FREE = ["exposure_us", "gain_db", "colour_space", "factory_settings", "trigger"]


def needs(*modules: str) -> None:
    """Skip where an optional library is not installed; it is not imported here, since gphoto2 reads its environment then."""
    if missing := [name for name in modules if find_spec(name) is None]:
        pytest.skip(f"not installed: {', '.join(missing)}")


def simulated(rig: str, *changes: str) -> Subject:
    session = load_trajectory("koala_realsense", overrides=changes)

    def make(settings: CameraSettings) -> Any:
        return camera_for(rig, session.model_copy(update={"camera": settings}), scene="grey_card")

    return Subject(make, session.camera, other_exposure_us=5000.0)


def basler(name: str, *, sums: bool = False) -> Subject:
    rejected = ({"binning": 5}, {"gain_db": 60.0}, {"width": 5000}, {"exposure_us": 3e8})
    settings = SMALL.model_copy(update={"pixel_format": name})
    return Subject(lambda wanted: Basler(wanted, emulated=True, sums=sums), settings, rejected, other_exposure_us=900.0)


def realsense() -> Subject:
    needs("pyrealsense2")
    from koala3d.capture.drivers.cameras.realsense import RealSense
    from koala3d.capture.sim.realsense_device import SoftwareRealSense
    from koala3d.capture.sim.truth import RigTruth

    device = Device.model_validate(
        {
            "model": "realsense",
            "leave": ["gain_db"],
            "settings": {"gain": 16, "depth.laser_power": 30},
            "depth": {"width": 424, "height": 240},
        }
    )
    source = SoftwareRealSense(RigTruth.draw(np.eye(4), 0).sensor_camera)
    source.show(np.full((240, 320, 3), 90, np.uint8), np.full((240, 424), 400, np.uint16))
    rejected = ({"width": 100}, {"binning": 2}, {"pixel_format": "bayer8"}, {"exposure_us": 5e5}, {"exposure_us": 30.0})
    settings = CameraSettings(width=320, height=240)
    return Subject(lambda wanted: RealSense(wanted, device, emulation=source), settings, rejected, other_exposure_us=5000.0)


def numbered_pictures(folder: Path) -> Subject:
    from koala3d.capture.drivers.cameras.opencv import OpenCvCamera

    for number in range(4):
        images.write(folder / f"{number:03d}.png", np.random.default_rng(number).integers(0, 255, (48, 64, 3), np.uint8))
    device = Device.model_validate({"model": "opencv", "source": str(folder / "%03d.png"), "leave": FREE[:2]})
    settings = CameraSettings(width=64, height=48)
    rejected = ({"width": 65}, {"pixel_format": "mono8"}, {"binning": 2}, {"offset_x": 4})
    return Subject(lambda wanted: OpenCvCamera(wanted, device), settings, rejected)


def film(folder: Path) -> Subject:
    writer = cv2.VideoWriter(str(folder / "film.avi"), cv2.VideoWriter.fourcc(*"FFV1"), 10, (64, 48))
    for number in range(4):
        writer.write(np.full((48, 64, 3), 50 * number, np.uint8))
    writer.release()
    from koala3d.capture.drivers.cameras.opencv import OpenCvCamera

    device = Device.model_validate({"model": "opencv", "source": str(folder / "film.avi"), "leave": FREE[:2]})
    return Subject(lambda wanted: OpenCvCamera(wanted, device), CameraSettings(width=64, height=48), ({"width": 65},))


def genicam() -> Subject:
    needs("harvesters", "genicam")
    from koala3d.capture.drivers.cameras.gentl import GenTlCamera

    device = Device.model_validate(
        {"model": "genicam", "source": producer(), "serial": "0", "leave": FREE, "settings": {"AcquisitionFrameRate": 200.0}}
    )
    settings = CameraSettings(width=104, height=104)
    rejected = ({"width": 8}, {"binning": 2}, {"pixel_format": "bayer12"}, {"offset_x": 8})
    return Subject(lambda wanted: GenTlCamera(wanted, device), settings, rejected)


def producer() -> str:
    """The GenTL producer that comes with the genicam package: a simulated camera that shows a game."""
    import genicam as package

    return str(Path(package.__file__).parent / "viky.cti")


def gphoto(folder: Path) -> Subject:
    needs("gphoto2")
    from koala3d.capture.drivers.cameras.gphoto import GphotoCamera

    pictures = folder / "store"
    cards = pictures / "DCIM" / "100GPHOT"
    cards.mkdir(parents=True)
    cv2.imwrite(str(cards / "GPH_0001.JPG"), np.full((480, 640, 3), 120, np.uint8))
    device = Device.model_validate({"model": "gphoto2", "leave": ["gain_db"], "settings": {"f-number": "f/8"}})
    settings = CameraSettings(width=640, height=480, exposure_us=20_000)
    rejected = ({"width": 1024, "height": 768}, {"exposure_us": 4000.0}, {"pixel_format": "bayer8"}, {"binning": 2})
    return Subject(lambda wanted: GphotoCamera(wanted, device, pictures=pictures), settings, rejected, other_exposure_us=5000.0)


SMALL_MODE = ("camera.width=320", "camera.height=240")
SUBJECTS: dict[str, Callable[[Path], Subject]] = {
    "basler rgb8": lambda folder: basler("rgb8"),
    "basler bayer12": lambda folder: basler("bayer12"),
    "basler mono8": lambda folder: basler("mono8"),
    "basler that adds up": lambda folder: basler("rgb8", sums=True),
    "simulated": lambda folder: simulated("sim", "camera.width=64", "camera.height=48", "camera.binning=4"),
    "realsense": lambda folder: realsense(),
    "simulated realsense": lambda folder: (needs("pyrealsense2"), simulated("sim:franka_realsense", *SMALL_MODE))[1],
    "numbered pictures": numbered_pictures,
    "film": film,
    "genicam": lambda folder: genicam(),
    "gphoto2": gphoto,
}


@pytest.mark.parametrize("name", SUBJECTS)
def test_a_driver_keeps_the_contract(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VCAMERADIR", os.environ.get("VCAMERADIR", ""))  # put back afterwards
    assert check(SUBJECTS[name](tmp_path)) == {}


class Ideal:
    """A camera in memory that keeps the contract."""

    def __init__(self, settings: CameraSettings) -> None:
        self.settings, self.exposure_us, self.is_open, self.taken = settings, settings.exposure_us, False, 0

    def __enter__(self) -> "Ideal":
        if self.settings.width > 4000:
            raise CaptureError("camera rejected Width", remedy="make it smaller")
        self.is_open = True
        return self

    def __exit__(self, *exception: object) -> None:
        self.is_open = False

    def grab(self) -> Image:
        if not self.is_open:
            raise CaptureError("camera is closed", remedy="open it")
        self.taken += 1
        pixels = np.full((self.settings.height, self.settings.width, 3), self.taken, np.uint8)
        return Image(pixels, self.exposure_us, self.settings.gain_db, 1000 * self.taken, time.monotonic_ns())

    def set_exposure(self, exposure_us: float) -> None:
        if exposure_us > 1e6:
            raise CaptureError("camera rejected ExposureTime", remedy="expose more briefly")
        self.exposure_us = exposure_us

    def description(self) -> dict[str, Any]:
        return dict.fromkeys(KEYS, "ideal") | {"exposure_us": self.exposure_us}


class Slow(Ideal):
    def __init__(self, settings: CameraSettings) -> None:
        super().__init__(settings)
        time.sleep(contract.QUICK_S)


class Wide(Ideal):
    def grab(self) -> Image:
        return replace(image := super().grab(), pixels=image.pixels.transpose(1, 0, 2))


class Late(Ideal):
    def grab(self) -> Image:
        return replace(super().grab(), host_time_ns=1)


class Shared(Ideal):
    buffer = np.zeros((48, 64, 3), np.uint8)

    def grab(self) -> Image:
        self.buffer[...] = (image := super().grab()).pixels
        return replace(image, pixels=self.buffer)


class Clipping(Ideal):
    def grab(self) -> Image:
        return replace(super().grab(), exposure_us=100.0)


class Deaf(Ideal):
    def set_exposure(self, exposure_us: float) -> None:
        if exposure_us > 1e6:
            raise CaptureError("camera rejected ExposureTime", remedy="expose more briefly")


class Reckless(Ideal):
    def set_exposure(self, exposure_us: float) -> None:
        self.exposure_us = exposure_us


class Nameless(Ideal):
    def description(self) -> dict[str, Any]:
        return {**super().description(), "state": {"gamma": float("nan")}}


class Deep(Ideal):
    def grab(self) -> Image:
        return replace(super().grab(), depth=np.zeros((4, 4), np.uint16))


class Lenient(Ideal):
    def __enter__(self) -> "Lenient":
        self.is_open = True
        return self


class Immortal(Ideal):
    def __exit__(self, *exception: object) -> None:
        pass


BROKEN = {
    Wide: {"a_picture_has_the_size_and_values_asked_for"},
    Late: {"a_picture_says_when_it_was_taken"},
    Shared: {"a_picture_keeps_its_values"},
    Clipping: {
        "exposure_and_gain_are_those_asked_for",
        "another_exposure_is_taken_up",
        "an_impossible_exposure_changes_nothing",
    },
    Deaf: {"another_exposure_is_taken_up"},
    Reckless: {"an_impossible_exposure_changes_nothing"},
    Nameless: {"the_description_can_be_stored"},
    Deep: {"depth_belongs_to_its_picture"},
    Lenient: {"a_rejected_setting_leaves_the_camera_free"},
    Immortal: {"it_can_be_closed_twice_and_opened_again"},
    Slow: {"making_one_touches_nothing"},
}


def ideal(kind: type[Ideal]) -> Subject:
    return Subject(kind, CameraSettings(width=64, height=48), ({"width": 5000},), other_exposure_us=5000.0)


def test_a_camera_in_memory_can_keep_it() -> None:
    assert check(ideal(Ideal)) == {}


def test_every_clause_is_broken_by_one_of_them() -> None:
    assert set().union(*BROKEN.values()) == set(CONTRACT)


@pytest.mark.parametrize("kind", [kind for kind in BROKEN if kind is not Slow], ids=lambda kind: kind.__name__)
def test_what_a_camera_does_wrong_is_noticed(kind: type[Ideal]) -> None:
    assert set(check(ideal(kind))) == BROKEN[kind]


def test_a_constructor_that_connects_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contract, "QUICK_S", 0.01)
    with pytest.raises(Broken, match="the constructor connects"):
        CONTRACT["making_one_touches_nothing"](ideal(Slow))


def test_an_error_without_a_remedy_breaks_it() -> None:
    class Curt(Ideal):
        def grab(self) -> Image:
            if not self.is_open:
                raise CaptureError("closed")
            return super().grab()

    assert check(ideal(Curt)) == {"it_can_be_closed_twice_and_opened_again": "an error without a remedy (closed)"}
