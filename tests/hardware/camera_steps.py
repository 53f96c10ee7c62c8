"""The steps with the camera: in which steps it exposes, and what its binning does."""

from collections.abc import Callable

import numpy as np

from koala3d.capture.drivers.cameras.base import CameraDriver
from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.model.trajectory import CameraSettings
from tests.hardware.steps import Ask, Step, judged, skipped

MakeCamera = Callable[[CameraSettings], CameraDriver]
PLAIN = CameraSettings(width=640, height=480, exposure_us=10_000, gain_db=0)
EXPOSURES_US = (100.0, 500.0, 1000.0, 1007.0, 5000.0, 10_000.0)
ROUNDED = 0.25  # share by which the driver lets a camera round
BRIGHTER = 0.15  # share by which a ratio of brightness may miss what the camera states: lamps flicker


def exposures(make: MakeCamera, ask: Ask) -> Step:
    """What the camera makes of exposure times, and how bright its pictures are then."""
    name = "exposure steps"
    if not ask("Take the cap off, and show the camera something that is neither black nor white."):
        return skipped(name, "by the operator")
    rows = []
    with make(PLAIN) as camera:
        for asked in EXPOSURES_US:
            try:
                camera.set_exposure(asked)
            except CaptureError as error:
                rows.append({"asked_us": asked, "refused": str(error)})
                continue
            image = camera.grab()
            rows.append({"asked_us": asked, "actual_us": image.exposure_us, "brightness": float(image.pixels.mean())})
    taken = [row for row in rows if "actual_us" in row]
    close = all(abs(row["actual_us"] - row["asked_us"]) <= ROUNDED * row["asked_us"] for row in taken)
    times = np.diff(sorted(row["actual_us"] for row in taken))
    finest = float(times[times > 0].min()) if (times > 0).any() else float("nan")
    brighter = taken[-1]["brightness"] >= taken[0]["brightness"] if len(taken) > 1 else False
    found = ", ".join(f"{row['asked_us']:g}: {row.get('actual_us', 'refused')}" for row in rows)
    found = f"{found} us; the closest two differ by {finest:g} us" + ("" if brighter else "; longer ones are darker")
    return judged(name, close and brighter, found, exposures=rows)


def binning(make: MakeCamera, ask: Ask) -> Step:
    """Whether binned pixels are averaged or added up, as the camera states it and as its pictures show it."""
    name = "binning modes"
    if not ask("Leave camera and lamps as they are."):
        return skipped(name, "by the operator")
    rows = []
    for factor in (1, 2, 4):
        settings = PLAIN.model_copy(update={"binning": factor, "width": 640 // factor, "height": 480 // factor})
        try:
            with make(settings) as camera:
                about, brightness = camera.description(), float(camera.grab().pixels.mean())
        except CaptureError as error:
            rows.append({"binning": factor, "refused": str(error)})
            continue
        rows.append({"binning": factor, "brightness": brightness, **{key: about[key] for key in KEPT if key in about}})
    taken = [row for row in rows if "brightness" in row]
    found = "; ".join(f"{row['binning']}: {_words(row, taken[0])}" for row in taken) or "none is taken"
    return judged(name, bool(taken), found, binning=rows)


KEPT = ("binning_modes", "binning_gain", "exposure_us")


def _words(row: dict, first: dict) -> str:
    modes = row.get("binning_modes") or {}
    stated = ", ".join(f"{axis} {mode.lower() or 'not stated'}" for axis, mode in modes.items())
    ratio = row["brightness"] / first["brightness"] if first["brightness"] else float("nan")
    return f"{stated or 'not stated'}, {ratio:.2f} times as bright at {row.get('exposure_us', float('nan')):g} us"
