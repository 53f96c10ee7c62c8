"""The pinhole camera that Mitsuba's pictures are taken with, as the dictionary that Mitsuba loads."""

from typing import Any

import numpy as np

from koala3d.datasets.camera_model import Camera

MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])


def pinhole(camera: Camera, to_world: Any, *, clip: tuple[float, float]) -> dict[str, Any]:
    """A camera without distortion, its principal point in the middle, that keeps opacity and linear light.

    Args:
        to_world: Mitsuba's transform of the camera's pose, whose axes are Mitsuba's.
        clip: distances of the nearest and the farthest thing that is seen [scene unit].
    """
    film = {
        "type": "hdrfilm",
        "width": camera.width,
        "height": camera.height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgba",
        "component_format": "float32",
    }
    return {
        "type": "perspective",
        "film": film,
        "sampler": {"type": "multijitter"},
        "near_clip": clip[0],
        "far_clip": clip[1],
        "fov_axis": "x",
        "fov": float(np.rad2deg(2 * np.arctan(0.5 * camera.width / camera.fx))),
        "to_world": to_world,
    }
