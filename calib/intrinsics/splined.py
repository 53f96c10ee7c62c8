"""The knots of a splined lens: how many, what is assumed of them, and whether corners ask for them.

The surface has as many knots as the corners can tell apart. Before the corners are looked at, knots are Gaussian about zero,
second differences too, and at the corners the surface holds nothing that the formula or a turn of the camera expresses as well.
So knots that no corner sees stay at zero and keep the deviation that is assumed, and the problem stays regular.

A surface can imitate a turn of the camera. Its axes are therefore a convention: those about which the formula alone fits best.
"""

from dataclasses import replace

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.errors import TargetError
from koala3d.calib.intrinsics import bundle, over_image, projection
from koala3d.calib.intrinsics.prior import IntrinsicsPrior
from koala3d.calib.solver.geometry import by_motion
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.spline import Grid, Spline

MIN_CORNERS = 250
CORNERS_PER_CELL = 25  # of the image, on average, where the grid is finer than its coarsest
COARSEST, FINEST = 3, 9  # cells along the image's longer side
SIZE = 5e-4
"""Standard deviation of a knot, and of its second differences, as a share of the image's longer side: 1 px of 2000."""
HELD = 100.0  # times more certain than a knot is that the surface holds nothing which the formula expresses
SURE = 5.0  # standard deviations by which the gain of a spline must exceed its mean without one, to be tried
NEGLIGIBLE = 1e-5  # what formula and turn express is taken for independent down to this share


def flat(camera: Camera, corners: int) -> Camera:
    """`camera` with a grid of knots for so many corners, all zero. Raises TargetError where these are too few."""
    if corners < MIN_CORNERS:
        why, remedy = f"{corners} corners were seen, at least {MIN_CORNERS} are needed", "record more views, or another --lens"
        raise TargetError("too few corners for a splined lens", why=why, remedy=remedy)
    longer, shorter = max(camera.width, camera.height), min(camera.width, camera.height)
    along = int(np.clip(np.sqrt(corners / CORNERS_PER_CELL * longer / shorter), COARSEST, FINEST))
    across = max(round(along * shorter / longer), 1)
    wide, high = (along, across) if camera.width >= camera.height else (across, along)
    step_x, step_y = camera.width / wide / camera.fx, camera.height / high / camera.fy
    left, top = -camera.cx / camera.fx - step_x, -camera.cy / camera.fy - step_y  # a knot beyond the border on each side
    return with_grid(camera, Grid(left, top, step_x, step_y, wide + 3, high + 3))


def with_grid(camera: Camera, grid: Grid | None) -> Camera:
    """`camera` with the knots of a grid, all zero; without knots where there is none."""
    return replace(camera, spline=None if grid is None else Spline(grid, (0.0,) * (2 * grid.count)))


def prior(camera: Camera, free: tuple[str, ...], pixels: Array) -> IntrinsicsPrior:
    """What is assumed of the knots of `camera`, if `free` intrinsics are estimated as well, from corners at (n, 2) `pixels`."""
    assert camera.spline is not None
    grid = camera.spline.grid
    std = SIZE * max(camera.width, camera.height) / float(np.sqrt(camera.fx * camera.fy))
    second = np.concatenate([_second_differences(grid.rows, grid.columns, axis) for axis in (0, 1)])
    smooth = np.kron(second.T @ second, np.eye(2))
    expressed = _expressed(camera, [name for name in free if not projection.is_knot(name)], pixels)
    precision = np.eye(2 * grid.count) + smooth + HELD**2 * expressed @ expressed.T
    covariance = np.asarray(std**2 * np.linalg.inv(precision), np.float64)
    return IntrinsicsPrior(projection.knot_names(grid), np.zeros(2 * grid.count), covariance)


def _second_differences(rows: int, columns: int, axis: int) -> Array:
    """(k, rows * columns) second differences of a grid along one axis."""
    return np.diff(np.eye(rows * columns).reshape(-1, rows, columns), 2, axis + 1).reshape(rows * columns, -1).T


def _expressed(camera: Camera, free: list[str], pixels: Array) -> Array:
    """(2 knots, g) orthonormal directions of knots.

    Knots at right angles to them move the corners at (n, 2) `pixels` by what neither `free` intrinsics nor a turn of the camera
    express, in the sense of least squares.
    """
    assert camera.spline is not None
    plain, points = replace(camera, spline=None), camera.directions(pixels)
    straight, by_point, by_intrinsics = projection.project(points, projection.vector(plain), projection.form(plain))
    focal = np.array([camera.fx, camera.fy])
    moved = np.concatenate([by_intrinsics[..., projection.columns(free)], by_motion(by_point, points)[..., 3:]], -1)
    moved = moved / focal[:, None] / np.abs(moved).max((0, 1))
    weights = camera.spline.grid.weights((straight - [camera.cx, camera.cy]) / focal)
    knots = np.einsum("nk,nag->kag", weights, moved).reshape(-1, moved.shape[-1])
    directions, sizes, _ = np.linalg.svd(knots / np.linalg.norm(knots, axis=0), full_matrices=False)
    return np.asarray(directions[:, sizes > NEGLIGIBLE], np.float64)


def most_px(camera: Camera) -> float:
    """Largest displacement by the knots of `camera` within its image [px]."""
    assert camera.spline is not None
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    bent = (over_image.cells(camera, 48, 48)[2] - centre) / focal
    return float(np.linalg.norm((bent - camera.spline.straighten(bent)) * focal, axis=1).max())


def in_words(camera: Camera) -> str:
    """One line about the knots of `camera`; empty where it has none."""
    if camera.spline is None:
        return ""
    grid = camera.spline.grid
    return f"{grid.columns} x {grid.rows} knots move pixels by up to {most_px(camera):.2f} px"


def asked_for(corners: bundle.Corners, camera: Camera, camera_from_board: Array, free: tuple[str, ...], sigma_px: float) -> bool:
    """Whether corners ask for the knots of `camera`, of which all are zero while everything else is fitted.

    A Gauss-Newton step of the knots lowers the cost, in units of `sigma_px` (a corner's deviation per axis), by a quadratic form
    of the residuals. With H = S (S + P)^-1, S the information of the corners on the knots and P that of the prior, noise
    alone gives it the mean tr H and the variance 2 tr H^2. What is found must exceed that by far.
    """
    known = prior(camera, free, corners.pixels)
    system = bundle.linearised(corners, camera, camera_from_board, (*free, *known.names), known, sigma_px)
    gain = float((system.side[len(free) :] ** 2).sum()) / sigma_px**2
    assumed = sigma_px * known.whitening @ np.linalg.inv(system.root[len(free) :, len(free) :])
    seen = np.eye(len(assumed)) - assumed.T @ assumed
    return gain > np.trace(seen) + SURE * np.sqrt(2 * np.sum(seen * seen))
