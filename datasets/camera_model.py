"""The camera: a pinhole with OpenCV's five-parameter distortion, in our pixel convention.

A point (x, y, z) in the camera frame has normalised coordinates (x/z, y/z), which the lens distorts
(Brown 1971, in the form of OpenCV's documentation, "Camera Calibration and 3D Reconstruction"):

    r2 = x*x + y*y,  radial = 1 + k1 r2 + k2 r2^2 + k3 r2^3
    x' = x radial + 2 p1 x y + p2 (r2 + 2 x*x)
    y' = y radial + p1 (r2 + 2 y*y) + 2 p2 x y
    pixel = (fx x' + cx, fy y' + cy),   first pixel's centre at (0.5, 0.5).
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datasets.errors import DatasetError

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one image. Sizes, focal lengths and centre in pixels; k1 k2 p1 p2 k3 are OpenCV's."""

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

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3) calibration matrix in our pixel coordinates."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def distortion(self) -> NDArray[np.float64]:
        """(5,) k1 k2 p1 p2 k3, in OpenCV's order."""
        return np.array([self.k1, self.k2, self.p1, self.p2, self.k3])

    @property
    def is_pinhole(self) -> bool:
        """True where there is no distortion at all."""
        return not self.distortion.any()

    @property
    def is_centred(self) -> bool:
        """True for a pinhole with square pixels and the principal point in the middle of the image."""
        middle = (self.width / 2, self.height / 2)
        return self.is_pinhole and self.fx == self.fy and (self.cx, self.cy) == middle

    def scaled(self, width: int, height: int) -> Self:
        """The camera of the same picture resampled to `width` x `height`: exact, as pixels are areas."""
        sx, sy = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy)

    def undistorted(self) -> Self:
        """The pinhole with the same size, focal lengths and centre."""
        return replace(self, k1=0.0, k2=0.0, p1=0.0, p2=0.0, k3=0.0)

    def distort(self, normalised: ArrayLike) -> Points:
        """(..., 2) ideal normalised coordinates to (..., 2) as the lens images them."""
        x, y = np.moveaxis(np.asarray(normalised, np.float64), -1, 0)
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return np.stack(
            [
                x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
                y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y,
            ],
            axis=-1,
        )

    def undistort(self, distorted: ArrayLike) -> Points:
        """Inverse of `distort` by Newton's method (to about 1e-14 within the lens's monotonic range)."""
        distorted = np.asarray(distorted, np.float64)
        if self.is_pinhole:
            return distorted.copy()
        normalised = distorted.copy()
        for _ in range(20):
            x, y = np.moveaxis(normalised, -1, 0)
            r2 = x * x + y * y
            radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
            slope = self.k1 + r2 * (2 * self.k2 + r2 * 3 * self.k3)  # d radial / d r2
            a = radial + 2 * x * x * slope + 2 * self.p1 * y + 6 * self.p2 * x
            b = 2 * x * y * slope + 2 * self.p1 * x + 2 * self.p2 * y
            d = radial + 2 * y * y * slope + 6 * self.p1 * y + 2 * self.p2 * x
            residual = self.distort(normalised) - distorted
            determinant = a * d - b * b
            safe = np.where(np.abs(determinant) > 1e-12, determinant, 1.0)
            step = np.stack([d * residual[..., 0] - b * residual[..., 1], a * residual[..., 1] - b * residual[..., 0]], -1)
            normalised = normalised - step / safe[..., None]
            if np.abs(residual).max(initial=0.0) < 1e-15:
                break
        return normalised

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

    def to_json(self) -> dict[str, float]:
        """Plain dictionary of the fields."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Camera from `to_json`'s dictionary.

        Raises:
            DatasetError: a field is missing, unknown, not finite or out of range.
        """
        try:
            values: dict[str, Any] = {k: int(v) if k in ("width", "height") else float(v) for k, v in content.items()}
            camera = cls(**values)
        except (TypeError, ValueError, AttributeError, OverflowError) as error:
            raise DatasetError("camera is not complete", where=where, why=str(error)) from None
        return camera.checked(where=where)

    def checked(self, *, where: object) -> Self:
        """This camera, if it can exist; else a DatasetError that names the value at fault."""
        values = np.array(list(asdict(self).values()), np.float64)
        if not np.isfinite(values).all():
            raise DatasetError("camera holds a value that is not finite", where=where, why=str(asdict(self)))
        if min(self.width, self.height) < 1 or min(self.fx, self.fy) <= 0:
            raise DatasetError("camera has no size or no focal length", where=where,
                               why=f"{self.width}x{self.height}, fx {self.fx:g}, fy {self.fy:g}")  # fmt: skip
        return self
