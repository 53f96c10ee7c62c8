"""Checks of a camera: which it is, how it is connected, how warm it is, and whether it takes a known state."""

from collections.abc import Callable

from koala3d.capture.doctor.lines import Line, compared, judged, ok, unknown, wrong
from koala3d.capture.drivers.cameras.nodes import Nodes, first
from koala3d.capture.drivers.cameras.start_state import load_default, set_colour_space, set_plain
from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.model.rig import CameraDescription

SLOWEST = 1.1e8  # a link below this is USB 2 (60 MB/s) or a network below 1 Gbit/s [bytes/s]
WARMEST_C = 80.0  # of the electronics; their noise doubles every 6 to 8 degrees
SPEEDS = ("DeviceLinkSpeed", "BslDeviceLinkCurrentThroughput")
STATES = ("BslTemperatureStatus", "TemperatureState")
DEGREES = ("DeviceTemperature", "TemperatureAbs")
NAMES = (
    "camera serial",
    "camera firmware",
    "camera link",
    "camera temperature",
    "factory settings",
    "camera settings",
    "colour space",
)


def missing(why: str) -> list[Line]:
    """The lines where no camera could be opened."""
    remedy = "check cable, power and camera.serial; close other programs that use it"
    return [wrong(NAMES[0], why, remedy), *(unknown(name, "no camera", "connect it first") for name in NAMES[1:])]


def check(nodes: Nodes, serial: str, stated: CameraDescription, *, encoded: bool) -> list[Line]:
    """The lines; sets the camera to its known state. `encoded`: whether it must send sRGB."""

    def encode() -> object:
        return set_colour_space(nodes, encoded=encoded)

    firmware = str(nodes.read("DeviceFirmwareVersion")) if nodes.has("DeviceFirmwareVersion") else ""
    return [
        compared(NAMES[0], serial, stated.serial, "camera.serial"),
        compared(NAMES[1], firmware, stated.firmware, "camera.firmware")
        if firmware
        else unknown(NAMES[1], "it does not say", "see pylon Viewer"),
        _link(nodes),
        _temperature(nodes),
        _left(stated, "factory_settings", lambda: tried(NAMES[4], lambda: load_default(nodes), "loaded"), NAMES[4]),
        tried(NAMES[5], lambda: set_plain(nodes), "not reversed, black level 0, gamma 1, no light-source preset"),
        _left(stated, "colour_space", lambda: tried(NAMES[6], encode, "sRGB" if encoded else "linear"), NAMES[6]),
    ]


def _link(nodes: Nodes) -> Line:
    name = first(nodes, SPEEDS)
    if name is None:
        return unknown(NAMES[2], "it does not say its link's speed", "use a USB 3 or Gigabit port")
    speed = float(nodes.read(name))
    return judged(NAMES[2], speed >= SLOWEST, f"{speed / 1e6:.0f} MB/s", "use a USB 3 or Gigabit port and cable, without a hub")


def _temperature(nodes: Nodes) -> Line:
    state, degrees = first(nodes, STATES), first(nodes, DEGREES)
    if state is None and degrees is None:
        return unknown(NAMES[3], "it does not measure it", "let it warm up for half an hour")
    warm = float(nodes.read(degrees)) if degrees is not None else 0.0
    word = str(nodes.read(state)) if state is not None else "Ok"
    found = word if degrees is None else f"{warm:.0f} degrees C, {word}"
    return judged(NAMES[3], word == "Ok" and warm < WARMEST_C, found, "mount it on metal, or give it air", blocks=False)


def _left(stated: CameraDescription, what: str, line: Callable[[], Line], name: str) -> Line:
    """The line, or that the rig file leaves this as it is."""
    if what in stated.leave:
        return unknown(name, "left as it is", f"the rig file says so: {what} in camera.leave")
    return line()


def tried(name: str, act: Callable[[], object], done: str) -> Line:
    """Whether the camera takes what `act` sets."""
    try:
        act()
    except CaptureError as error:
        return wrong(name, f"{error.what} ({error.why})", error.remedy or "use another camera")
    return ok(name, done)
