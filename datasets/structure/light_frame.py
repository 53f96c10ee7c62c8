"""The frame in which the lamps stand still: that of the world, of the camera, or of a turntable under the object.

On a matte surface a point's colour is its albedo times the light that its normal receives. Where the lamps stand still with the
object, it is the same in all views. Where they move with the camera, or where the object turns before still lamps, it follows the
normal as seen in the lamps' frame, and so do highlights with the reflected direction. In logarithms, for point p in view i,

    log colour(p, i) = albedo(p) + gain(i) + vignette(pixel) + f(F(i) n(p)) + h(F(i) r(p, i)),

with normal n, reflected direction r, and F(i) the rotation from the world to the lamps' frame: the identity, camera_from_world,
or the camera's azimuth about the turntable's axis. f and h are spherical harmonics up to order two, which is all that matte
reflection passes on (Ramamoorthi and Hanrahan 2001). Each frame is fitted by robust least squares; what it explains is
measured on points that the fit has not seen.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.structure.exposure import CLIPPED, DARK
from koala3d.datasets.structure.matching import Matches
from koala3d.datasets.structure.triangulate import Cloud

FRAMES = ("world", "camera", "turntable")
FOLDS = 5
FEWEST_POINTS, FEWEST_SIGHTINGS = 60, 300
"""With less, no frame is fitted."""
NEIGHBOURS = 12
"""Points from which a normal is estimated."""


@dataclass(frozen=True, eq=False)
class LightFrames:
    """How well each frame explains the colours of points from view to view."""

    explained: dict[str, float]
    """By frame, the share of the variation of log colours (within each point, beyond gains and vignetting) explained in points
    that the fit has not seen; 0 or less where the frame explains nothing. NaN where too few points are known."""
    margin: float
    """Share explained by the best of "camera" and "turntable" less that of "world"."""
    std: float
    """Standard deviation of `margin`, from the folds."""
    variation: float
    """Standard deviation of the log colours within a point, beyond gains and vignetting."""
    axis: NDArray[np.float64]
    """(3,) unit axis of the turntable that was assumed: the direction across which the cameras' sides lie."""
    points: int
    sightings: int

    @property
    def best(self) -> str:
        """The frame that explains most, of those that explain anything."""
        known = [name for name in FRAMES if np.isfinite(self.explained[name])]
        return max(known or FRAMES, key=lambda name: self.explained[name])


@dataclass(frozen=True, eq=False)
class _Sightings:
    """Points as views see them, sorted in any order; n sightings."""

    point: NDArray[np.int64]
    view: NDArray[np.int64]
    log_light: NDArray[np.float64]
    normal: NDArray[np.float64]
    """(n, 3) of the point, in the world."""
    reflected: NDArray[np.float64]
    """(n, 3) direction in the world that a mirror would show."""
    radius2: NDArray[np.float64]
    """(n,) squared distance from the optical axis at z = 1."""


def light_frames(matches: Matches, cloud: Cloud, world_from_camera: NDArray[np.float64]) -> LightFrames:
    """Fit each frame to the colours of triangulated points.

    Args:
        matches: features and their colours.
        cloud: points triangulated from `matches`, with the features behind them.
        world_from_camera: (views, 4, 4).
    """
    seen = _sightings(matches, cloud, world_from_camera)
    axis, azimuth = turntable(world_from_camera)
    points = len(np.unique(seen.point))
    if points < FEWEST_POINTS or len(seen.point) < FEWEST_SIGHTINGS:
        return LightFrames(dict.fromkeys(FRAMES, np.nan), np.nan, np.nan, np.nan, axis, points, len(seen.point))
    camera = np.swapaxes(world_from_camera[:, :3, :3], 1, 2)
    still = np.broadcast_to(np.eye(3), camera.shape)
    common = _common(seen, len(world_from_camera))
    fold = np.random.default_rng(0).permutation(int(seen.point.max()) + 1)[seen.point] % FOLDS
    rest, _ = _errors(seen, common, fold)
    errors = {}
    for name, frame in zip(FRAMES, (still, camera, azimuth), strict=True):
        errors[name], _ = _errors(seen, np.concatenate([common, _lit(seen, frame, moving=name != "world")], axis=1), fold)
    shares = {name: 1 - float(values.sum() / rest.sum()) for name, values in errors.items()}
    moving = max(FRAMES[1:], key=lambda name: shares[name])
    by_fold = np.array([(errors["world"] - errors[moving])[fold == k].sum() / rest[fold == k].sum() for k in range(FOLDS)])
    variation = float(np.sqrt(rest.mean()))
    std = float(by_fold.std(ddof=1) / np.sqrt(FOLDS))
    return LightFrames(shares, shares[moving] - shares["world"], std, variation, axis, points, len(seen.point))


def turntable(world_from_camera: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The axis of a turntable before a still camera, in the world, and each view's rotation about it.

    An upright camera's side, or that of one turned by a right angle, stays across the axis. The axis points to the cameras' upper
    side.

    Returns:
        (3,) unit axis; (views, 3, 3) rotations that take the world to the frame that turns with the camera about the axis.
    """
    best = None
    for side in (0, 1):
        sides = world_from_camera[:, :3, side]
        values, vectors = np.linalg.eigh(sides.T @ sides / len(sides))
        if best is None or values[0] < best[0]:
            best = values[0], vectors[:, 0], sides, side
    assert best is not None
    _, axis, sides, side = best
    upwards = -world_from_camera[:, :3, 1 - side].mean(0)
    axis = axis if axis @ upwards >= 0 else -axis
    across = sides - (sides @ axis)[:, None] * axis
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    third = np.cross(axis, across)
    return axis, np.stack([across, third, np.broadcast_to(axis, across.shape)], axis=1)


def _sightings(matches: Matches, cloud: Cloud, world_from_camera: NDArray[np.float64]) -> _Sightings:
    point, view = cloud.sightings.T
    colour = np.array([matches.features[v].colours[f] for v, f in zip(view, cloud.features, strict=True)]).reshape(-1, 3)
    local = np.array([matches.features[v].directions[f] for v, f in zip(view, cloud.features, strict=True)]).reshape(-1, 3)
    lit = (colour.min(1) > DARK) & (colour.max(1) < CLIPPED)
    often = np.bincount(point[lit], minlength=len(cloud.points)) >= 3
    kept = np.flatnonzero(lit & often[point])
    point, view, colour, local = point[kept], view[kept], colour[kept], local[kept]
    towards = world_from_camera[view, :3, 3] - cloud.points[point]
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    normal = normals(cloud, world_from_camera)[point]
    reflected = 2 * (normal * towards).sum(1, keepdims=True) * normal - towards
    return _Sightings(point, view, np.log(colour.mean(1)), normal, reflected, (local[:, :2] ** 2).sum(1))


def normals(cloud: Cloud, world_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """(points, 3) unit normals of the planes through neighbouring points, turned to the cameras that saw each point.

    Where the neighbours lie in no plane, the mean direction to the cameras takes over.
    """
    from scipy.spatial import KDTree

    towards = world_from_camera[cloud.sightings[:, 1], :3, 3] - cloud.points[cloud.sightings[:, 0]]
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    mean = np.zeros_like(cloud.points)
    np.add.at(mean, cloud.sightings[:, 0], towards)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    if len(cloud.points) <= NEIGHBOURS:
        return mean
    near = cloud.points[KDTree(cloud.points).query(cloud.points, NEIGHBOURS)[1]]
    near = near - np.median(near, axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
    normal = vectors[:, :, 0] * np.sign((vectors[:, :, 0] * mean).sum(1, keepdims=True) + 1e-12)
    flat = np.clip(1 - 4 * values[:, :1] / np.maximum(values[:, 1:2], 1e-300), 0, 1)  # 1 in a plane, 0 in a blob
    mixed = flat * normal + (1 - flat) * mean
    return mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-12)


def _common(seen: _Sightings, views: int) -> NDArray[np.float64]:
    """(n, views + 2) what every frame is granted: a gain per view, and vignetting."""
    gains = np.zeros((len(seen.view), views))
    gains[np.arange(len(seen.view)), seen.view] = 1.0
    scale = max(float(seen.radius2.max()), 1e-12)
    return np.concatenate([gains, (seen.radius2 / scale)[:, None] ** [1, 2]], axis=1)


def _lit(seen: _Sightings, frame: NDArray[np.float64], *, moving: bool) -> NDArray[np.float64]:
    """(n, 8 or 16) harmonics of the reflected direction and, where the light moves, of the normal in the lamps' frame."""
    turn = frame[seen.view]
    found = [_harmonics(np.einsum("nij,nj->ni", turn, seen.reflected))]
    if moving:  # else they are part of a point's albedo
        found.append(_harmonics(np.einsum("nij,nj->ni", turn, seen.normal)))
    return np.concatenate(found, axis=1)


def _harmonics(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 8) real spherical harmonics of orders one and two of unit directions, not normalised."""
    x, y, z = directions.T
    return np.stack([x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1], axis=1)


def _errors(seen: _Sightings, columns: NDArray[np.float64], fold: NDArray[np.int64]) -> tuple[NDArray[np.float64], float]:
    """(n,) squared residuals of points left out of the fit, clipped so that no single one decides; and where they are clipped."""
    count = np.bincount(seen.point).clip(1)

    def within(values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values less their mean over each point's sightings."""
        sums = np.zeros((len(count), *values.shape[1:]))
        np.add.at(sums, seen.point, values)
        return values - sums[seen.point] / count[seen.point].reshape(-1, *[1] * (values.ndim - 1))

    target, design = within(seen.log_light), within(columns)
    limit = 3 * 1.4826 * float(np.median(np.abs(target))) + 1e-3
    squared = np.zeros(len(target))
    for k in range(FOLDS):
        trained, held = fold != k, fold == k
        weight, solution = np.ones(int(trained.sum())), np.zeros(design.shape[1])
        for _ in range(4):
            weighted = design[trained] * weight[:, None]
            ridge = 1e-3 * trained.sum() / design.shape[1] * np.eye(design.shape[1])
            solution = np.linalg.solve(design[trained].T @ weighted + ridge, weighted.T @ target[trained])
            residual = np.abs(target[trained] - design[trained] @ solution)
            weight = np.minimum(1.0, limit / 2 / np.maximum(residual, 1e-12))
        squared[held] = np.minimum(np.abs(target[held] - design[held] @ solution), limit) ** 2
    return squared, limit
