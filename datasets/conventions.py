"""The only place where foreign conventions are converted to ours.

Ours: OpenCV camera axes (x right, y down, z forward), first pixel's centre at (0.5, 0.5), quaternions `wxyz`.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Camera coordinates with y up and z back (Blender, nerfstudio) to ours; its own inverse."""

OPENCV_FROM_MITSUBA = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Camera coordinates with x left, y up, z forward (Mitsuba, instant-ngp's "from_mitsuba") to ours; its own inverse."""

OPENCV_FROM_LLFF = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
"""Camera coordinates with x down, y right, z back (poses_bounds.npy) to ours; its own inverse."""

OPENCV_PIXEL_SHIFT = 0.5
"""Our pixel coordinate minus that of OpenCV's functions, which put the first pixel's centre at (0, 0)."""


def pixels_from_opencv(pixels: ArrayLike) -> NDArray[np.float64]:
    """Corners or principal points as OpenCV's functions give them, in our pixel coordinates."""
    return np.asarray(pixels, np.float64) + OPENCV_PIXEL_SHIFT


def opencv_from_pixels(pixels: ArrayLike) -> NDArray[np.float64]:
    """Our pixel coordinates as OpenCV's functions expect them."""
    return np.asarray(pixels, np.float64) - OPENCV_PIXEL_SHIFT
