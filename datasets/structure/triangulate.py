"""Surface points triangulated from matches with known poses, and the agreement of poses and matches.

A track is one point of the world seen by several views. Its position is the point nearest to all its rays. Views that miss it by
more than two pixels are dropped, and so are points seen by fewer than three views.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets.scene import View
from koala3d.datasets.structure.matching import Matches

Indices = NDArray[np.int64]

TOLERANCE_PX = 2.0
"""Largest distance of a ray from its point [px of the image that was searched]."""
FEWEST = 3
"""Smallest number of views per point; two rays can meet by chance."""
LEAST_SPREAD = 5e-4
"""Smallest eigenvalue, per ray, of the projections across a track's rays: about the squared sine of 2.5 degrees over 4."""
DOUBTFUL = 0.15
"""Poses are doubted where a smaller share of the matches agrees with them. Chance gives 0.02; small images of a golden head,
whose reflections move between views, give 0.34."""
NO_PARALLAX = np.deg2rad(0.3)
"""Rays at a smaller angle count as parallel, given the accuracy of poses and features."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Triangulated points and the sightings behind them."""

    points: NDArray[np.float64]
    """(n, 3) in the world."""
    sightings: NDArray[np.int64]
    """(m, 2) index of a point, and of a view in `Matches.views` that saw it."""
    features: NDArray[np.int64]
    """(m,) index of the feature behind each sighting in its view's features."""
    errors_px: NDArray[np.float64]
    """(m,) distance between point and feature in the image that was searched."""


def triangulate(matches: Matches, world_from_camera: NDArray[np.float64]) -> Cloud:
    """Points of all tracks on which at least three views agree. `world_from_camera` is (views, 4, 4)."""
    offsets = np.cumsum([0, *(len(features.directions) for features in matches.features)])
    rows = _tracks(matches, world_from_camera, offsets)
    view = np.repeat(np.arange(len(matches.views)), np.diff(offsets))
    local = np.concatenate([features.directions for features in matches.features]) if len(rows) else np.zeros((0, 3))
    pixel = np.array([features.pixel for features in matches.features])[view]
    sighting = np.flatnonzero(np.bincount(rows, minlength=len(rows))[rows] >= FEWEST)
    count = int(rows.max(initial=-1)) + 1
    for tolerance in (4 * TOLERANCE_PX, 2 * TOLERANCE_PX, TOLERANCE_PX, TOLERANCE_PX, TOLERANCE_PX):
        points = _nearest_points(world_from_camera, view[sighting], local[sighting], rows[sighting], count)
        errors = _errors(world_from_camera, view[sighting], local[sighting], points[rows[sighting]]) / pixel[sighting]
        good = errors < tolerance
        sighting, errors = sighting[good], errors[good]
    enough = np.bincount(rows[sighting], minlength=count) >= FEWEST
    good = enough[rows[sighting]]
    new_index = np.cumsum(enough) - 1
    sightings = np.stack([new_index[rows[sighting][good]], view[sighting][good]], axis=1)
    features = sighting[good] - offsets[view[sighting[good]]]
    return Cloud(points[enough], sightings, features, errors[good])


def meeting_point(sightings: Sequence[tuple[View, ArrayLike]]) -> NDArray[np.float64] | None:
    """(3,) the point nearest to the rays of some views through one (2,) pixel each; None where the rays are parallel."""
    matrices = np.stack([view.world_from_camera for view, _ in sightings])
    local = np.stack([view.camera.directions(pixel) for view, pixel in sightings])
    rays = np.einsum("nij,nj->ni", matrices[:, :3, :3], local)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal, origins = across.sum(0), matrices[:, :3, 3]
    if np.linalg.eigvalsh(normal)[0] < LEAST_SPREAD * len(rays):
        return None
    middle = origins.mean(0)
    return np.asarray(middle + np.linalg.solve(normal, np.einsum("nij,nj->i", across, origins - middle)), np.float64)


def explained(
    matches: Matches, pair: tuple[int, int, NDArray[np.int64]], world_from_camera: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """(k,) for each match of one of the pairs, whether its rays meet in front of both cameras, to within the tolerance."""
    return _meets(matches, pair, world_from_camera).agreed


def meeting_places(
    matches: Matches, pair: tuple[int, int, NDArray[np.int64]], world_from_camera: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """`explained`, and the (k, 3) points of the first view's rays that are nearest to the second's, in the world."""
    found = _meets(matches, pair, world_from_camera)
    return found.agreed, found.places


def agreement(matches: Matches, world_from_camera: NDArray[np.float64]) -> float:
    """Share of matches that the poses can explain: rays that meet in front of both cameras, to within the tolerance."""
    agreed = sum(int(explained(matches, pair, world_from_camera).sum()) for pair in matches.pairs)
    return agreed / max(matches.count, 1)


def endless_share(matches: Matches, world_from_camera: NDArray[np.float64], baseline: float) -> float:
    """Share of explained matches between cameras at least `baseline` apart whose rays are parallel, so of distant points."""
    parallel = total = 0
    for pair in matches.pairs:
        i, j, _ = pair
        if np.linalg.norm(world_from_camera[i, :3, 3] - world_from_camera[j, :3, 3]) < baseline:
            continue
        found = _meets(matches, pair, world_from_camera)
        parallel += int((found.agreed & (found.angle < NO_PARALLAX)).sum())
        total += int(found.agreed.sum())
    return parallel / max(total, 1)


class _Meetings(NamedTuple):
    """How the rays of k matches meet."""

    agreed: NDArray[np.bool_]
    """(k,) whether they do, in front of both cameras."""
    angle: NDArray[np.float64]
    """(k,) between them [rad]."""
    places: NDArray[np.float64]
    """(k, 3) where the first is nearest to the second, in the world."""


def _meets(matches: Matches, pair: tuple[int, int, NDArray[np.int64]], world_from_camera: NDArray[np.float64]) -> _Meetings:
    """How the rays of the matches of a pair meet."""
    i, j, index = pair
    first, second = matches.features[i], matches.features[j]
    a = first.directions[index[:, 0]] @ world_from_camera[i, :3, :3].T
    b = second.directions[index[:, 1]] @ world_from_camera[j, :3, :3].T
    a, b = (rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in (a, b))
    baseline = world_from_camera[j, :3, 3] - world_from_camera[i, :3, 3]
    tolerance = TOLERANCE_PX * max(first.pixel, second.pixel)
    across = np.cross(baseline, a)
    length = np.linalg.norm(across, axis=1)
    out_of_plane = np.abs((across * b).sum(1)) / np.maximum(length, 1e-300)
    cosine = (a * b).sum(1)
    sine2 = np.maximum(1 - cosine**2, 1e-12)  # the distances along both rays at which they are closest
    along_a = (a @ baseline - cosine * (b @ baseline)) / sine2
    along_b = (cosine * (a @ baseline) - b @ baseline) / sine2
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), cosine)
    in_front = ((along_a > 0) & (along_b > 0)) | (angle < NO_PARALLAX)
    places = world_from_camera[i, :3, 3] + along_a[:, None] * a
    return _Meetings((out_of_plane < tolerance) & in_front & (length > 0), angle, places)


def _tracks(matches: Matches, world_from_camera: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """(all features,) track of each feature: matches that the poses explain, joined."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, second = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for pair in matches.pairs:
        i, j, index = pair
        kept = index[_meets(matches, pair, world_from_camera)[0]]
        first.append(offsets[i] + kept[:, 0])
        second.append(offsets[j] + kept[:, 1])
    ends = np.concatenate(first), np.concatenate(second)
    graph = coo_array((np.ones(len(ends[0]), bool), ends), shape=(int(offsets[-1]),) * 2)
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _nearest_points(
    world_from_camera: NDArray[np.float64], view: Indices, local: NDArray[np.float64], track: Indices, count: int
) -> NDArray[np.float64]:
    """(count, 3) point nearest to the rays of each track; NaN where the rays are too few or too parallel."""
    rotation, origin = world_from_camera[view, :3, :3], world_from_camera[view, :3, 3]
    rays = np.einsum("nij,nj->ni", rotation, local)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal, target = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(normal, track, across)
    np.add.at(target, track, np.einsum("nij,nj->ni", across, origin))
    rays_of = np.bincount(track, minlength=count)
    fixed = np.flatnonzero(rays_of >= FEWEST)
    fixed = fixed[np.linalg.eigvalsh(normal[fixed])[:, 0] > LEAST_SPREAD * rays_of[fixed]]
    points = np.full((count, 3), np.nan)
    points[fixed] = np.linalg.solve(normal[fixed], target[fixed, :, None])[..., 0]
    return points


def _errors(
    world_from_camera: NDArray[np.float64], view: NDArray[np.int64], local: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) distance at z = 1 between observation and projection of each point; infinite behind the camera."""
    local_points = np.einsum("nij,ni->nj", world_from_camera[view, :3, :3], points - world_from_camera[view, :3, 3])
    front = local_points[:, 2] > 0  # false for NaN too
    ideal = local_points[:, :2] / np.where(front, local_points[:, 2], 1.0)[:, None]
    return np.where(front, np.linalg.norm(ideal - local[:, :2], axis=1), np.inf)
