"""Checks of cameras that do not follow GenICam: the same lines as `capture.doctor.camera`, from what each of them can say."""

from collections.abc import Mapping

from koala3d.capture.doctor.camera import NAMES, WARMEST_C, tried
from koala3d.capture.doctor.lines import Line, compared, judged, ok, unknown
from koala3d.capture.drivers.cameras.nodes import Nodes, put_all
from koala3d.capture.model.rig import CameraDescription

DEGREES = ("depth.asic_temperature", "TEMPERATURE")
USB3 = "3"
"""Beginning of what a camera on a USB 3 link says of it."""


def check(nodes: Nodes, serial: str, facts: Mapping[str, str], stated: CameraDescription) -> list[Line]:
    """The lines; brings the camera to the start state of its driver, with the settings of the rig file.

    Args:
        facts: what it says of `firmware` and `link`, where it does.
    """
    firmware, link = facts.get("firmware", ""), facts.get("link", "")
    return [
        compared(NAMES[0], serial, stated.serial, "camera.serial")
        if serial
        else unknown(NAMES[0], "it does not say", "connect only one camera"),
        compared(NAMES[1], firmware, stated.firmware, "camera.firmware")
        if firmware
        else unknown(NAMES[1], "it does not say", "see its maker's software"),
        judged(NAMES[2], link.startswith(USB3), f"USB {link}", "use a USB 3 port and cable, without a hub")
        if link
        else unknown(NAMES[2], "it does not say its link's speed", "use a USB 3 port"),
        _temperature(nodes),
        _start_state(nodes, stated),
        tried(NAMES[5], lambda: put_all(nodes, stated.settings, "camera.settings"), _listed(stated)),
        _colours(nodes, stated),
    ]


def _listed(stated: CameraDescription) -> str:
    return ", ".join(f"{name} {value}" for name, value in stated.settings.items()) or "the rig file names none"


def _temperature(nodes: Nodes) -> Line:
    warm = next((float(nodes.read(name)) for name in DEGREES if nodes.has(name)), 0.0)
    if warm <= 0:  # OpenCV answers 0 for what a device does not have
        return unknown(NAMES[3], "it does not measure it", "let it warm up for half an hour")
    return judged(NAMES[3], warm < WARMEST_C, f"{warm:.0f} degrees C", "mount it on metal, or give it air", blocks=False)


def _start_state(nodes: Nodes, stated: CameraDescription) -> Line:
    if stated.model != "realsense":
        return unknown(NAMES[4], f"{stated.model} has no command for them", "reset it by its menus or its maker's software")
    from koala3d.capture.drivers.cameras.realsense import OptionNodes, set_start_state

    def load() -> None:
        assert isinstance(nodes, OptionNodes)
        set_start_state(nodes)

    return tried(NAMES[4], load, "set, automatic functions off")


def _colours(nodes: Nodes, stated: CameraDescription) -> Line:
    if stated.model == "realsense":
        return ok(NAMES[6], "sRGB")
    if not nodes.has("colorspace"):
        return unknown(NAMES[6], "it does not say", "photograph a grey card: 'capture look'")
    found = str(nodes.read("colorspace"))
    return judged(NAMES[6], found.lower() == "srgb", found, "set colorspace to sRGB in camera.settings")
