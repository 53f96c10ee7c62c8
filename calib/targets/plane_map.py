"""A smooth map from the plane of a target to its picture, exact enough for second derivatives.

A homography, then radial distortion about the middle of the picture, then a cubic polynomial for what is left:

    u = homography(q),   pixel = middle + scale (1 + k1 |u|^2 + k2 |u|^4) u + polynomial(q)

A polynomial alone does not follow the product of perspective and distortion. It leaves the focal length wrong by 0.03 %.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from koala3d.calib.arrays import Array

FEWEST = 9  # points that determine the map
_STEPS = 8
_DIFFERENCE = 1e-6  # step of the numerical derivatives


@dataclass(frozen=True)
class PlaneMap:
    """Maps places on a target to pixels. Places are used about `origin`, in units of `size`."""

    origin: Array  # (2,) [m]
    size: float  # [m]
    middle: Array  # (2,) of the picture [px]
    scale: float  # half the picture's diagonal [px]
    lens: Array  # (10,) homography without its last element, which is 1; then k1 and k2
    polynomial: Array  # (10, 2) coefficients of `_powers` [px]

    def __call__(self, points: Array) -> Array:
        """(n, 2) pixels of (n, 2) places on the target [m]."""
        places = (points - self.origin) / self.size
        return self.middle + self.scale * _seen(self.lens, places) + _powers(places) @ self.polynomial


def fit(points: Array, pixels: Array, width: int, height: int) -> PlaneMap:
    """The map that takes (n, 2) places on a target [m] to (n, 2) pixels of a picture of `width` x `height`; n >= `FEWEST`."""
    origin, middle = points.mean(axis=0), np.array([width, height]) / 2
    size, scale = float(np.abs(points - origin).max()), float(np.hypot(width, height) / 2)
    places, ideal = (points - origin) / size, (pixels - middle) / scale
    homography = np.asarray(cv2.findHomography(places, ideal)[0], np.float64)
    lens = np.append(homography.ravel()[:8] / homography[2, 2], [0.0, 0.0])
    for _ in range(_STEPS):
        left = ideal - _seen(lens, places)
        steps = _DIFFERENCE * np.eye(len(lens))
        columns = [(_seen(lens + step, places) - _seen(lens - step, places)).ravel() / (2 * _DIFFERENCE) for step in steps]
        lens = lens + np.linalg.lstsq(np.stack(columns, -1), left.ravel(), rcond=1e-7)[0]
    left = pixels - middle - scale * _seen(lens, places)
    return PlaneMap(origin, size, middle, scale, lens, np.linalg.lstsq(_powers(places), left, rcond=1e-6)[0])


def _seen(lens: Array, places: Array) -> Array:
    """(n, 2) ideal places in the picture after a homography and radial distortion."""
    seen = np.column_stack([places, np.ones(len(places))]) @ np.append(lens[:8], 1.0).reshape(3, 3).T
    flat = seen[:, :2] / seen[:, 2:]
    r2 = (flat**2).sum(axis=1, keepdims=True)
    return np.asarray(flat * (1 + r2 * (lens[8] + r2 * lens[9])), np.float64)


def _powers(places: Array) -> Array:
    """(n, 10) products of powers of (n, 2) places up to the third degree."""
    x, y = places.T
    return np.stack([x**a * y**b for a in range(4) for b in range(4 - a)], -1)
