"""One lens fitted to all views of a target, from a start."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError, Unobservable
from koala3d.calib.intrinsics import bundle, projection, splined
from koala3d.calib.intrinsics.lenses import Lens
from koala3d.calib.targets.detection import Observation
from koala3d.datasets.camera_model import Camera

DIRECTIONS = "record views from more directions"
TILT = "tilt the target by 20 to 40 degrees in several directions and fill the image with it"
"""What to do where a fit fails."""


def fit(observations: Sequence[Observation], first: Camera, poses: Array, lens: Lens) -> tuple[Camera, bundle.Bundle]:
    """Camera with the coefficients of `lens` and the poses of all views, from a start. Raises CalibrationError, Unobservable."""
    start = projection.vector(first)
    if first.fisheye != lens.fisheye or set(lens.coefficients) < {"k1", "k2", "p1", "p2"}:
        start[4:] = 0.0
        start[4] = -1 / 3 if first.fisheye and not lens.fisheye else 0.0
    formula = replace(lens, grid=None)
    fitted = bundle.fit(flat(observations), start[:12], poses, formula.free, formula.form)
    camera = _fitted_camera(first, fitted, formula)
    if lens.grid is None:
        return camera, fitted
    camera = splined.with_grid(camera, lens.grid)
    known, start = splined.prior(camera, formula.free, flat(observations).pixels), projection.vector(camera)
    for _ in range(2):  # the deviation of corners, against which the prior is weighed, is smaller with knots
        sigma_px = float(np.sqrt(fitted.variance))
        fitted = bundle.fit(flat(observations), start, fitted.camera_from_board, lens.free, lens.form, known, sigma_px)
        start = fitted.intrinsics
    return _fitted_camera(first, fitted, lens), fitted


def _fitted_camera(first: Camera, fitted: bundle.Bundle, lens: Lens) -> Camera:
    """The camera of a fit. Raises CalibrationError, Unobservable, DatasetError where it is impossible."""
    if not np.isfinite(fitted.residuals).all():
        raise CalibrationError("intrinsics cannot be fitted", why="the fit diverged", remedy=DIRECTIONS)
    if not fitted.intrinsics[:2].min() > 0:
        raise Unobservable("focal length is not observable", why=f"the fit gives {fitted.intrinsics[0]:.3g} px", remedy=TILT)
    base = Camera(first.width, first.height, 1, 1, 0, 0, fisheye=lens.fisheye)
    base = splined.with_grid(base, lens.grid)
    return projection.with_vector(base, fitted.intrinsics).checked(where="estimated camera")


def flat(observations: Sequence[Observation]) -> bundle.Corners:
    """The corners of all views in one list."""
    view = np.repeat(np.arange(len(observations)), [len(o.ids) for o in observations])
    pixels, points = (np.concatenate(parts) for parts in zip(*((o.pixels, o.points) for o in observations), strict=True))
    return bundle.Corners(view, pixels, points)


def rms(vectors: Array) -> float:
    """Root mean square length of (n, 2) vectors."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=-1))))
