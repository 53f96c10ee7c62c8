"""Checks of a camera: which it is, how it is connected, how warm it is, and whether it takes a known state."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from koala3d.capture.doctor.lines import Line, compared, judged, ok, unknown, wrong
from koala3d.capture.drivers.cameras.nodes import Nodes, first, put_all, tried
from koala3d.capture.drivers.cameras.start_state import load_default, set_colour_space, set_plain
from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.model.rig import CameraDescription

SLOWEST = 1.1e8  # a link below this is USB 2 (60 MB/s) or a network below 1 Gbit/s [bytes/s]
USB3 = "3"
"""Beginning of what a camera on a USB 3 link says of it."""
WARMEST_C = 80.0  # of the electronics; their noise doubles every 6 to 8 degrees
SPEEDS = ("DeviceLinkSpeed", "BslDeviceLinkCurrentThroughput")
STATES = ("BslTemperatureStatus", "TemperatureState")
DEGREES = ("DeviceTemperature", "TemperatureAbs", "depth.asic_temperature", "TEMPERATURE")
SERIAL, FIRMWARE, LINK, TEMPERATURE = "camera serial", "camera firmware", "camera link", "camera temperature"
USB_MEMORY = "USB memory"
USBFS = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
USB_TRANSPORTS = ("BaslerUsb", "U3V")  # as pylon and GenTL producers call USB3 Vision
QUEUED = 2  # pictures for which a driver reserves memory
COLOURS_OF_A_PIXEL = 3  # bytes of the widest format, rgb8
FACTORY, SETTINGS, COLOURS = "factory settings", "camera settings", "colour space"
NAMES = (SERIAL, FIRMWARE, LINK, TEMPERATURE, FACTORY, SETTINGS, COLOURS)


def missing(why: str) -> list[Line]:
    """The lines if no camera could be opened."""
    remedy = "check cable, power and camera.serial; close other programs that use it"
    return [wrong(SERIAL, why, remedy), *(unknown(name, "no camera", "connect it first") for name in NAMES[1:])]


def usbfs_memory_mb() -> float | None:
    """Memory that Linux gives to all transfers over USB together [MB]; 0: any; None: not Linux, or no USB."""
    try:
        return float(USBFS.read_text())
    except (OSError, ValueError):
        return None


def check(
    nodes: Nodes,
    serial: str,
    facts: Mapping[str, str],
    stated: CameraDescription,
    *,
    encoded: bool = True,
    genicam: bool = False,
    cameras: int = 1,
    usb_mb: float | None = None,
) -> list[Line]:
    """The lines. Whether the camera takes the known state of its driver is tried, and every setting is put back.

    Args:
        facts: see `capture.drivers.cameras.base.InspectedCamera`.
        encoded: whether it must send sRGB.
        genicam: whether its settings are those of GenICam.
        cameras: how many share the computer's memory for USB, `usb_mb`, see `usbfs_memory_mb`.
    """
    firmware = facts.get("firmware") or (str(nodes.read("DeviceFirmwareVersion")) if nodes.has("DeviceFirmwareVersion") else "")
    named = [
        compared(SERIAL, serial, stated.serial, "camera.serial")
        if serial
        else unknown(SERIAL, "it does not say", "connect only one camera"),
        compared(FIRMWARE, firmware, stated.firmware, "camera.firmware")
        if firmware
        else unknown(FIRMWARE, "it does not say", "see its maker's software"),
        _link(nodes, facts.get("link", "")),
        _temperature(nodes),
    ]
    if facts.get("transport") in USB_TRANSPORTS and usb_mb is not None:
        named.append(_usb_memory(nodes, cameras, usb_mb))
    return [*named, *(_genicam_state(nodes, stated, encoded) if genicam else _other_state(nodes, stated))]


def _link(nodes: Nodes, usb: str) -> Line:
    remedy = "use a USB 3 or Gigabit port and cable, without a hub"
    if usb:
        return judged(LINK, usb.startswith(USB3), f"USB {usb}", remedy)
    name = first(nodes, SPEEDS)
    if name is None:
        return unknown(LINK, "it does not say its link's speed", remedy)
    speed = float(nodes.read(name))
    return judged(LINK, speed >= SLOWEST, f"{speed / 1e6:.0f} MB/s", remedy)


def _usb_memory(nodes: Nodes, cameras: int, available_mb: float) -> Line:
    """Whether the pictures that are queued fit into the memory that Linux reserves, 16 MB by default."""
    pixels = [float(nodes.read(name)) if nodes.has(name) else 0.0 for name in ("WidthMax", "HeightMax")]
    needed_mb = cameras * QUEUED * COLOURS_OF_A_PIXEL * pixels[0] * pixels[1] / 2**20
    found = f"{available_mb:.0f} MB, {needed_mb:.0f} MB needed"
    remedy = f"echo 1000 | sudo tee {USBFS}; to keep it, usbcore.usbfs_memory_mb=1000 on the kernel's command line"
    return judged(USB_MEMORY, available_mb == 0 or available_mb >= needed_mb, found, remedy)


def _temperature(nodes: Nodes) -> Line:
    state, degrees = first(nodes, STATES), first(nodes, DEGREES)
    warm = float(nodes.read(degrees)) if degrees is not None else 0.0
    if state is None and warm <= 0:  # OpenCV answers 0 for what a device does not have
        return unknown(TEMPERATURE, "it does not measure it", "let it warm up for half an hour")
    word = str(nodes.read(state)) if state is not None else "Ok"
    found = word if degrees is None else f"{warm:.0f} degrees C, {word}"
    return judged(TEMPERATURE, word == "Ok" and warm < WARMEST_C, found, "mount it on metal, or give it air", blocks=False)


def _genicam_state(nodes: Nodes, stated: CameraDescription, encoded: bool) -> list[Line]:
    colours = "sRGB" if encoded else "linear"
    steps: dict[str, tuple[str, Callable[[Nodes], object], str]] = {
        FACTORY: ("factory_settings", load_default, "can be loaded"),
        SETTINGS: ("", set_plain, "not reversed, black level 0, gamma 1, no light-source preset"),
        COLOURS: ("colour_space", partial(set_colour_space, encoded=encoded), colours),
    }
    return [
        unknown(name, "left as it is", f"the rig file says so: {key} in camera.leave")
        if key in stated.leave
        else _tried(name, nodes, act, done)
        for name, (key, act, done) in steps.items()
    ]


def _other_state(nodes: Nodes, stated: CameraDescription) -> list[Line]:
    start = unknown(FACTORY, f"{stated.model} has no command for them", "reset it by its menus or its maker's software")
    if stated.model == "realsense":
        from koala3d.capture.drivers.cameras.realsense import OptionNodes, set_start_state

        assert isinstance(nodes, OptionNodes)
        start = _tried(FACTORY, nodes, partial(set_start_state, default=nodes.default), "taken, automatic functions off")
    listed = ", ".join(f"{name} {value}" for name, value in stated.settings.items()) or "the rig file names none"
    settings = _tried(SETTINGS, nodes, partial(put_all, settings=stated.settings, where="camera.settings"), listed)
    if stated.model == "realsense":
        return [start, settings, ok(COLOURS, "sRGB")]
    if not nodes.has("colorspace"):
        return [start, settings, unknown(COLOURS, "it does not say", "photograph a grey card: 'capture look'")]
    found = str(nodes.read("colorspace"))
    return [start, settings, judged(COLOURS, found.lower() == "srgb", found, "set colorspace to sRGB in camera.settings")]


def _tried(name: str, nodes: Nodes, act: Callable[[Nodes], object], done: str) -> Line:
    """Whether the camera takes what `act` sets; it is put back."""
    try:
        with tried(nodes) as on_trial:
            act(on_trial)
    except CaptureError as error:
        return wrong(name, f"{error.what} ({error.why})", error.remedy or "use another camera")
    return ok(name, done)
