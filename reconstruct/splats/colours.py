"""Colours of surfels for all directions: what the model's own pictures show of each, from wherever cameras were or nearly so."""

import numpy as np
from jaxtyping import Bool, Float, Int

from koala3d.datasets.core.console import progress
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.splats import harmonics
from koala3d.reconstruct.splats.surfels import Surfels, sided

PLACES, AROUND = 1024, 16
"""Places to look from: training cameras, and places between one and two of so many that are next to it."""
LOOKS = 64
"""At each surfel, from places that it faces. 16 functions follow a mirror image only with several hundred directions: surfels
share theirs with their neighbours."""
SHARED = 7
"""Surfels that share their looks: itself, and those next to it."""
FACING = 0.1
"""Cosine of normal and direction to the camera below which a surfel is not looked at."""
NEAR = 1 / 64
"""How far from a surfel the model may see its surface along a ray, as a share of the longest side of the object's box."""
STIFFNESS = 3e-4
"""See `harmonics.solved`. With less, directions that few places cover get wrong colours."""
BLOCK = 1 << 12
"""Surfels that are looked at together."""


def coefficients(trained: TrainedModel, surfels: Surfels) -> tuple[Float[np.ndarray, "n functions 3"], Bool[np.ndarray, " n"]]:
    """Spherical harmonics of each surfel's sRGB, and which surfels the model shows at all.

    The others get the coefficients of the nearest of those.
    """
    from scipy.spatial import KDTree

    places, random = vantage_points(trained.scene), np.random.default_rng(0)
    sums = []
    with progress("looking at splats", len(surfels.points), "splats") as shown:
        for start in range(0, len(surfels.points), BLOCK):
            part = slice(start, start + BLOCK)
            looks = _looks(trained, surfels.points[part], surfels.normals[part], places, random)
            sums.append(harmonics.sums(*looks))
            shown.advance(len(looks[0]))
    left, right = (np.concatenate(arrays) for arrays in zip(*sums, strict=True))
    seen, tree = left[:, 0, 0] > 0, sided(surfels)
    if not seen.any():
        return np.zeros_like(right), seen
    shared = KDTree(tree).query(tree, k=min(SHARED, len(tree)))[1].reshape(len(tree), -1)
    found = np.concatenate(
        [
            harmonics.solved(left[rows].sum(1), right[rows].sum(1), stiffness=STIFFNESS)
            for rows in np.array_split(shared, np.arange(BLOCK, len(shared), BLOCK))
        ]
    )
    found[~seen] = found[seen][KDTree(surfels.points[seen]).query(surfels.points[~seen])[1]]
    return found, seen


def vantage_points(scene: Scene) -> Float[np.ndarray, "places 3"]:
    """Training cameras and places between them, as seen from the object (world frame).

    Most are near the lines between cameras: without the rim of what cameras cover, colours there are continued, and wrong.
    """
    from scipy.spatial import KDTree

    centre, random = np.asarray(scene.box, np.float64).mean(0), np.random.default_rng(0)
    cameras = np.stack([view.world_from_camera[:3, 3] for view in scene.split("train")]) - centre
    distances = np.maximum(np.linalg.norm(cameras, axis=-1, keepdims=True), 1e-12)
    towards, around = cameras / distances, min(len(cameras), AROUND + 1)
    nearest = KDTree(towards).query(towards, k=around)[1].reshape(len(cameras), around)
    first = random.integers(len(cameras), size=PLACES)
    corners = np.stack([first, *nearest[first, random.integers(around, size=(2, PLACES))]], -1)
    shares = random.dirichlet(np.full(3, 0.5), PLACES)[..., None]
    mixed = np.sum(towards[corners] * shares, 1)
    mixed /= np.maximum(np.linalg.norm(mixed, axis=-1, keepdims=True), 1e-12)
    return centre + np.concatenate([cameras, mixed * np.sum(distances[corners] * shares, 1)])[:PLACES]


def _looks(
    trained: TrainedModel,
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    places: Float[np.ndarray, "places 3"],
    random: np.random.Generator,
) -> tuple[Float[np.ndarray, "n m 3"], Float[np.ndarray, "n m 3"], Float[np.ndarray, "n m"]]:
    """Unit directions to the points, the sRGB that the model shows along them, and how much that is worth.

    Nothing, if the point is turned away or the model's surface along the ray is elsewhere.
    """
    normalisation, renderer = trained.run.normalisation, trained.renderer
    chosen = _facing(points, normals, places, random)
    rays = points[:, None] - places[chosen]
    distances = np.linalg.norm(rays, axis=-1)
    directions = (rays / distances[..., None]).astype(np.float32)
    looked = np.flatnonzero(np.einsum("nmk,nk->nm", directions, normals) < -FACING)
    origins = ((places[chosen] - normalisation.centre) * normalisation.scale).reshape(-1, 3)[looked].astype(np.float32)
    along, radii = directions.reshape(-1, 3)[looked], np.full(len(looked), _pixel(trained), np.float32)
    found = renderer.rays(trained.model, origins, along, radii)
    opacity = found["opacity"]
    own = (found["rgb"] - (1 - opacity) * np.asarray(renderer.behind)) / np.maximum(opacity, 1e-6)
    apart = np.abs(found["depth"][:, 0] / normalisation.scale - distances.reshape(-1)[looked])
    seen = (opacity[:, 0] > 0.5) & (apart < NEAR * float(np.ptp(trained.scene.box, axis=0).max()))
    colours, weights = np.zeros((*distances.shape, 3), np.float32), np.zeros(distances.shape, np.float32)
    colours.reshape(-1, 3)[looked] = np.clip(own, 0, 1)
    weights.reshape(-1)[looked] = opacity[:, 0] * seen
    return directions, colours, weights


def _facing(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    places: Float[np.ndarray, "places 3"],
    random: np.random.Generator,
) -> Int[np.ndarray, "n m"]:
    """For each point `LOOKS` random places, first of all those that it faces."""
    heights = normals @ places.T - np.sum(normals * points, -1, keepdims=True)
    order = random.random(heights.shape, np.float32) + (heights <= 0)
    return np.argpartition(order, min(LOOKS, len(places)) - 1)[:, :LOOKS]


def _pixel(trained: TrainedModel) -> float:
    """Radius of a training pixel's cone at unit distance, see `Rays`."""
    camera = trained.camera(trained.scene.views[0])
    return float(2 / np.sqrt(12) / np.sqrt(camera.fx * camera.fy))
