"""A known state of a Basler camera, whatever was set before: factory settings, then all that changes colours or geometry.

Names and values differ by family (Basler, "PLCamera" of the pylon API): ace USB has `ColorSpace`, ace 2, boost and dart 2 have
`BslColorSpace`, dart and pulse `BslColorSpaceMode`, ace GigE `GammaSelector` with `GammaEnable`. On ace USB a light-source preset
applies a gamma of about 0.4 by itself, so presets are off.
"""

from koala3d.capture.drivers.cameras.nodes import Nodes, first, put
from koala3d.capture.drivers.errors import CaptureError

SRGB = {"ColorSpace": "sRGB", "BslColorSpace": "sRgb", "BslColorSpaceMode": "sRGB", "GammaSelector": "sRGB"}
LINEAR = {"ColorSpace": "RGB", "BslColorSpace": "Off", "BslColorSpaceMode": "RGB"}
"""Settings that make a camera encode its colours as sRGB, and leave them linear."""
PRESETS = ("LightSourcePreset", "BslLightSourcePreset")
BLACK = ("BlackLevel", "BlackLevelRaw")
PEDESTAL = 64.0
"""Black level of a camera whose noise is measured, so that the noise of darkness is not cut off at 0 [values of 12 bits]."""


def load_default(nodes: Nodes) -> None:
    """Load the factory settings. Raises CaptureError: the camera cannot."""
    if not (nodes.has("UserSetSelector") and nodes.has("UserSetLoad")):
        raise CaptureError("camera cannot load its factory settings", why="no UserSetLoad", remedy="use another camera")
    put(nodes, "UserSetSelector", "Default")
    nodes.write("UserSetLoad", None)


def set_plain(nodes: Nodes) -> None:
    """No reversal, no offset of black, no light-source preset, gamma 1; each only where the camera has it, and read back."""
    for name in ("ReverseX", "ReverseY"):
        if nodes.has(name):
            put(nodes, name, False)
    if (name := first(nodes, BLACK)) is not None:
        put(nodes, name, 0, tolerance=1e-6)
    for name in PRESETS:
        if nodes.has(name):
            put(nodes, name, "Off")
    if nodes.has("Gamma"):
        put(nodes, "Gamma", 1.0, tolerance=1e-3)


def set_pedestal(nodes: Nodes) -> None:
    """Raise the black level by `PEDESTAL`; the pixel format has 12 bits. A camera that counts it in units of its own keeps 0."""
    if nodes.has("BlackLevel"):
        put(nodes, "BlackLevel", PEDESTAL, tolerance=0.5)


def set_colour_space(nodes: Nodes, *, encoded: bool) -> str:
    """Make the camera send sRGB (`encoded`) or linear light; the name of the setting that does it, empty: none is needed.

    Raises CaptureError: pictures would be called sRGB and be linear, because the camera has none of the settings.
    """
    wanted = SRGB if encoded else LINEAR
    name = first(nodes, wanted, lambda one: wanted[one] in nodes.symbolics(one))
    if name is None:
        if not encoded:
            return ""
        why, remedy = (
            f"it has none of {', '.join(SRGB)}",
            "set camera.pixel_format to bayer8 or bayer12: Koala encodes those itself",
        )
        raise CaptureError("camera cannot send sRGB", why=why, remedy=remedy)
    put(nodes, name, wanted[name])
    if name == "GammaSelector":
        put(nodes, "GammaEnable", True)
    return name
