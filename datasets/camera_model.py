"""The camera: a pinhole with OpenCV's distortion, in our pixel convention.

A point (x, y, z) in the camera frame has normalised coordinates (x/z, y/z), which the lens distorts
(Brown 1971, in the form of OpenCV's documentation, "Camera Calibration and 3D Reconstruction"):

    r2 = x*x + y*y,  radial = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
    x' = x radial + 2 p1 x y + p2 (r2 + 2 x*x)
    y' = y radial + p1 (r2 + 2 y*y) + 2 p2 x y
    pixel = (fx x' + cx, fy y' + cy),   first pixel's centre at (0.5, 0.5).

Most lenses need only k1 k2 p1 p2 k3; k4 k5 k6 belong to OpenCV's rational model. A fisheye lens (Kannala & Brandt 2006,
OpenCV's `fisheye`) has instead, with a = arctan(r) the angle from the axis,

    radial = a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8) / r

Either may have a `spline`, which moves (x', y') by what the formula leaves over (`datasets.spline`).
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.spline import Spline

Points = NDArray[np.float64]
WIDEST, RADII = np.deg2rad(89.0), 1024
"""Largest angle of a ray from the axis [rad], whose direction has z = 1; and radii at which a lens is tabulated up to there."""
INVERTED = 1e-6
"""Largest error of a distortion that was inverted, in focal lengths: a thousandth of a pixel."""
_KINDS: dict[str, type] = {"width": int, "height": int, "fisheye": bool}


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one image. Sizes, focal lengths and centre in pixels; k1 k2 p1 p2 k3 k4 k5 k6 are OpenCV's."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    fisheye: bool = False
    """True where the coefficients k1 k2 k3 k4 are those of a fisheye lens."""
    spline: Spline | None = None
    """What the lens does beside the formula, where it was estimated."""

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3) calibration matrix in our pixel coordinates."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def distortion(self) -> NDArray[np.float64]:
        """(8,) k1 k2 p1 p2 k3 k4 k5 k6, in OpenCV's order."""
        return np.array([self.k1, self.k2, self.p1, self.p2, self.k3, self.k4, self.k5, self.k6])

    @property
    def is_pinhole(self) -> bool:
        """True where there is no distortion."""
        return not (self.fisheye or self.distortion.any() or self.spline)

    @property
    def is_centred(self) -> bool:
        """True for a pinhole with square pixels and the principal point in the middle, to 1e-9."""
        deviation = max(abs(self.cx - self.width / 2), abs(self.cy - self.height / 2), abs(self.fx - self.fy))
        return self.is_pinhole and deviation <= 1e-9 * max(self.width, self.height)

    def scaled(self, width: int, height: int) -> Self:
        """The camera of the same image resampled to `width` x `height`; exact, since pixels are areas."""
        sx, sy = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy)

    def within(self, side: int) -> Self:
        """The camera of the same image shrunk until no side is longer than `side` [px]; of small images, the same."""
        scale = min(1.0, side / max(self.width, self.height))
        return self.scaled(max(round(scale * self.width), 1), max(round(scale * self.height), 1))

    def undistorted(self) -> "Camera":
        """The pinhole with the same size, focal lengths and centre."""
        return Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)

    def distort(self, normalised: ArrayLike) -> Points:
        """(..., 2) ideal normalised coordinates to (..., 2) distorted ones."""
        if self.is_pinhole:
            return np.asarray(normalised, np.float64)
        bent = self._by_formula(normalised)
        return bent if self.spline is None else self.spline.bend(bent)

    def _by_formula(self, normalised: ArrayLike) -> Points:
        """`distort` without the spline."""
        x, y = np.moveaxis(np.asarray(normalised, np.float64), -1, 0)
        r2 = x * x + y * y
        radial, _ = self.radial(r2)
        distorted_x = x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        distorted_y = y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        return np.stack([distorted_x, distorted_y], axis=-1)

    def radial(self, r2: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(radial factor at the squared radius `r2`, its derivative by r2), of any shape."""
        r2 = np.asarray(r2, np.float64)
        if self.fisheye:
            return fisheye_radial(r2, (self.k1, self.k2, self.k3, self.k4))
        above, slope_above = _cubic(r2, self.k1, self.k2, self.k3)
        if not (self.k4 or self.k5 or self.k6):
            return above, slope_above
        below, slope_below = _cubic(r2, self.k4, self.k5, self.k6)
        return above / below, (slope_above * below - above * slope_below) / below**2

    def undistort(self, distorted: ArrayLike) -> Points:
        """Inverse of `distort` by Newton's method (to about 1e-14 within the lens's monotonic range)."""
        distorted = np.asarray(distorted, np.float64)
        if self.is_pinhole:
            return distorted.copy()
        if self.spline is not None:
            distorted = self.spline.straighten(distorted)
        normalised = self._first_guess(distorted)
        for _ in range(20):
            x, y = np.moveaxis(normalised, -1, 0)
            radial, slope = self.radial(x * x + y * y)
            a = radial + 2 * x * x * slope + 2 * self.p1 * y + 6 * self.p2 * x
            b = 2 * x * y * slope + 2 * self.p1 * x + 2 * self.p2 * y
            d = radial + 2 * y * y * slope + 6 * self.p1 * y + 2 * self.p2 * x
            residual = self._by_formula(normalised) - distorted
            determinant = a * d - b * b
            safe = np.where(np.abs(determinant) > 1e-12, determinant, 1.0)
            step = np.stack([d * residual[..., 0] - b * residual[..., 1], a * residual[..., 1] - b * residual[..., 0]], -1)
            normalised = normalised - step / safe[..., None]
            if np.abs(residual).max(initial=0.0) < 1e-15:
                break
        return normalised

    @cached_property
    def _radii(self) -> Points:
        """(2, n) ideal and distorted radii from the axis to where the distorted one stops to grow, or to `WIDEST`."""
        ideal = np.tan(np.linspace(0, WIDEST, RADII))
        bent = ideal * self.radial(ideal * ideal)[0]
        growing = np.append(np.diff(bent) > 0, False)
        end = int(np.argmin(growing)) + 1
        return np.stack([ideal[:end], bent[:end]])

    def _first_guess(self, distorted: Points) -> Points:
        """The start of Newton's method: what the radial factor alone says, within the range in which it can be inverted."""
        ideal, bent = self._radii
        radius = np.linalg.norm(distorted, axis=-1, keepdims=True)
        return distorted * np.where(radius > 1e-9, np.interp(radius, bent, ideal) / np.maximum(radius, 1e-9), 1.0)

    def valid(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """(...) whether (..., 2) pixel coordinates have a ray: the lens can be inverted there, within `WIDEST` of the axis."""
        distorted = (np.asarray(pixels, np.float64) - [self.cx, self.cy]) / [self.fx, self.fy]
        if self.is_pinhole:
            return np.ones(distorted.shape[:-1], bool)
        normalised = self.undistort(distorted)
        wrong = np.abs(self.distort(normalised) - distorted).max(-1)
        return (wrong < INVERTED) & (np.linalg.norm(normalised, axis=-1) < self._radii[0, -1])

    def valid_pixels(self) -> NDArray[np.bool_] | None:
        """(height, width) `valid` of all pixel centres, read-only; None if all are, which the border of the picture tells."""
        return _valid_pixels(self)

    def _is_valid_at_the_border(self) -> bool:
        across, down = np.arange(self.width) + 0.5, np.arange(self.height) + 0.5
        sides = ((across, down[0]), (across, down[-1]), (across[0], down), (across[-1], down))
        border = np.concatenate([np.stack(np.broadcast_arrays(*side), axis=-1) for side in sides])
        return bool(self.valid(border).all())

    def project(self, points: ArrayLike) -> Points:
        """(..., 3) points in the camera frame [m] to (..., 2) pixels. Points need z > 0."""
        points = np.asarray(points, np.float64)
        return self.distort(points[..., :2] / points[..., 2:]) * [self.fx, self.fy] + [self.cx, self.cy]

    def directions(self, pixels: ArrayLike) -> Points:
        """(..., 2) pixel coordinates to (..., 3) ray directions in the camera frame with z = 1."""
        distorted = (np.asarray(pixels, np.float64) - [self.cx, self.cy]) / [self.fx, self.fy]
        normalised = self.undistort(distorted)
        return np.concatenate([normalised, np.ones((*normalised.shape[:-1], 1))], axis=-1)

    def pixel_centres(self) -> Points:
        """(height, width, 2) coordinates of all pixel centres."""
        columns, rows = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([columns, rows], axis=-1).astype(np.float64)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary of the fields; k4 k5 k6, fisheye and spline only where they are not zero."""
        numbers = {k: v for k, v in self._numbers().items() if v or k not in ("k4", "k5", "k6", "fisheye")}
        return numbers if self.spline is None else numbers | {"spline": self.spline.to_json()}

    def _numbers(self) -> dict[str, float]:
        """All fields but the spline."""
        return {one.name: getattr(self, one.name) for one in fields(Camera) if one.name != "spline"}

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Camera from `to_json`'s dictionary.

        Raises:
            DatasetError: a field is missing, unknown, not finite or out of range.
        """
        try:
            values: dict[str, Any] = {k: _KINDS.get(k, float)(v) for k, v in content.items() if k != "spline"}
            stored = content.get("spline")
            camera = cls(**values, spline=None if stored is None else Spline.from_json(stored, where=f"{where}, spline"))
        except (TypeError, ValueError, AttributeError, OverflowError) as error:
            raise DatasetError("camera is not complete", where=where, why=str(error)) from None
        return camera.checked(where=where)

    def checked(self, *, where: object) -> Self:
        """This camera if its values are possible; else a DatasetError that names the wrong value."""
        if not np.isfinite(np.array(list(self._numbers().values()), np.float64)).all():
            raise DatasetError("camera holds a value that is not finite", where=where, why=str(self._numbers()))
        if min(self.width, self.height) < 1 or min(self.fx, self.fy) <= 0:
            why = f"{self.width}x{self.height}, fx {self.fx:g}, fy {self.fy:g}"
            raise DatasetError("camera has no size or no focal length", where=where, why=why)
        if self.spline is not None:
            self.spline.checked(where=f"{where}, spline")
        return self


@lru_cache(maxsize=4)
def _valid_pixels(camera: Camera) -> NDArray[np.bool_] | None:
    """`Camera.valid_pixels`, kept: views share cameras, and training asks again for each turn of a view."""
    if camera._is_valid_at_the_border():
        return None
    valid = camera.valid(camera.pixel_centres())
    valid.flags.writeable = False
    return valid


def fisheye_radial(r2: Points, coefficients: ArrayLike) -> tuple[Points, Points]:
    """Distorted over ideal radius of a fisheye with (4,) k1 k2 k3 k4, and its derivative by the squared ideal radius `r2`."""
    near = r2 < 1e-8
    r = np.sqrt(np.where(near, 1.0, r2))
    angle = np.arctan(r)
    square = angle * angle
    k1, k2, k3, k4 = np.asarray(coefficients, np.float64)
    bent = angle * (1 + square * (k1 + square * (k2 + square * (k3 + square * k4))))
    by_angle = 1 + square * (3 * k1 + square * (5 * k2 + square * (7 * k3 + square * 9 * k4)))
    slope = (by_angle / (1 + r * r) - bent / r) / (2 * r * r)
    at_axis = k1 - 1 / 3  # arctan(r) = r - r^3 / 3 + ...
    return np.where(near, 1 + at_axis * r2, bent / r), np.where(near, at_axis, slope)


def _cubic(r2: Points, a: float, b: float, c: float) -> tuple[Points, Points]:
    """1 + a r2 + b r2^2 + c r2^3 and its derivative by r2."""
    return 1 + r2 * (a + r2 * (b + r2 * c)), a + r2 * (2 * b + r2 * 3 * c)
