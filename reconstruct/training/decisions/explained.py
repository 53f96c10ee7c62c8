"""How well a scene's colours are explained by lamps that stand still in one frame or another, before anything is trained.

Where rays of the training pixels meet the masks' hull, logarithms of their colours are fitted by a sum of what depends on the
place on the object (random Fourier features, Rahimi and Recht 2007), on how far it faces the camera, and on the directions of
normal and reflection in the frame's axes. The right frame explains views best that the fit has not seen.
"""

from collections.abc import Sequence
from itertools import combinations_with_replacement

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from koala3d.datasets.imaging.images import linear_from_srgb
from koala3d.datasets.scene import View
from koala3d.datasets.structure.masks.silhouette import PIXELS_APART
from koala3d.reconstruct.scene.light import LightFrame
from koala3d.reconstruct.scene.rays import Pixels

PIXELS, FEWEST = 20_000, 2_000
"""Pixels that are fitted, at most and at least."""
STEPS = 192
"""Steps of a ray through the cube."""
FOLD = 5
"""Every so many views one is left out of the fit."""
WAVES = ((2.0, 100), (6.0, 200))
"""Standard deviation [rad per scene unit] and number of the waves over the object."""
DARK = 0.02
"""Added to linear colours before their logarithm is taken."""
GRAZING = 0.15
"""Cosine to the camera below which a hull's normal is not trusted."""
RIDGE = 1e-3

Vectors = Float[np.ndarray, "n 3"]


def errors(
    views: tuple[View, ...], pixels: Pixels, possible: Bool[np.ndarray, " cells"], frames: Sequence[LightFrame]
) -> list[float] | None:
    """Mean square error of logarithmic colours in views that were left out, for each frame; None where too little is seen.

    Args:
        possible: cells of the object's cube that masks leave.
    """
    rng = np.random.default_rng(0)
    chosen = rng.permutation(np.flatnonzero(np.asarray(pixels.colour[:, 3]) > 0.99))[:PIXELS]
    rays, colour = pixels.take(jnp.asarray(np.sort(chosen)))
    viewdirs = np.asarray(rays.viewdirs, np.float64)
    origins = np.asarray(rays.origins, np.float64)
    pixel = np.median(np.asarray(rays.radii) * np.linalg.norm(origins, axis=-1)) * np.sqrt(12) / 2
    points, normals = _hull_points(origins, viewdirs, possible, pixel)
    facing = -np.sum(normals * viewdirs, -1)
    seen = facing > GRAZING
    view = np.asarray(rays.view)[seen]
    if seen.sum() < FEWEST or len(views) < 2 * FOLD:
        return None
    points, normals, viewdirs, facing = points[seen], normals[seen], viewdirs[seen], facing[seen, None]
    target = np.log(linear_from_srgb(np.clip(np.asarray(colour)[seen, :3], 0, None)) + DARK)
    waves = np.concatenate([scale * rng.normal(size=(3, count)) for scale, count in WAVES], -1)
    everywhere = np.cos(points @ waves + rng.uniform(0, 2 * np.pi, waves.shape[1]))
    shared = np.concatenate([everywhere, *(facing**power for power in range(5))], -1)
    reflected = 2 * facing * normals + viewdirs
    rotations = np.stack([each.world_from_camera[:3, :3] for each in views])
    held, found = view % FOLD == 0, []
    for frame in frames:
        rotation = frame.from_scene(rotations)
        turned = [d if rotation is None else np.einsum("nij,nj->ni", rotation[view], d) for d in (normals, reflected)]
        columns = [monomials(turned[0], 2), monomials(turned[0], 3), monomials(turned[1], 3), monomials(turned[1], 4)]
        found.append(_left_out(np.concatenate([shared, *columns], -1), target, held))
    return found


def monomials(directions: Vectors, degree: int) -> Float[np.ndarray, "n terms"]:
    """Products of `degree` components: two successive degrees span the harmonics up to the higher one."""
    chosen = combinations_with_replacement(range(3), degree)
    return np.stack([directions[:, list(each)].prod(-1) for each in chosen], -1)


def _hull_points(
    origins: Vectors, viewdirs: Vectors, possible: Bool[np.ndarray, " cells"], pixel: float
) -> tuple[Vectors, Vectors]:
    """Where rays meet the hull, smoothed, and its unit outward normals; zero normals for those that miss it.

    Args:
        pixel: width of a pixel at the object [scene unit]. Cells are left that are partly inside the masks, or nearly so:
            the hull is as much smaller.
    """
    size = round(len(possible) ** (1 / 3))
    solid = possible.reshape((size,) * 3)
    wider = np.sqrt(3) / 2 + PIXELS_APART * pixel * size / 2
    depth = distance_transform_edt(solid) - distance_transform_edt(~solid) - wider
    soft = gaussian_filter(depth.astype(np.float32), 1.5)
    nearest, reach = -np.sum(origins * viewdirs, -1), np.sqrt(3)
    t = nearest[:, None] + np.linspace(-reach, reach, STEPS)
    along = origins[:, None] + t[..., None] * viewdirs[:, None]
    cell = np.clip((along + 1) / 2 * size, 0, size - 1).astype(int)
    inside = (soft[tuple(np.moveaxis(cell, -1, 0))] > 0) & np.all(np.abs(along) < 1, -1)
    points = along[np.arange(len(t)), inside.argmax(-1)]
    place = ((points + 1) / 2 * size - 0.5).T
    slope = np.stack([map_coordinates(axis, place, order=1, mode="nearest") for axis in np.gradient(soft)], -1)
    length = np.linalg.norm(slope, axis=-1, keepdims=True)
    return points, np.where(inside.any(-1, keepdims=True), -slope / np.maximum(length, 1e-9), 0.0)


def _left_out(features: Float[np.ndarray, "n terms"], target: Vectors, held: Bool[np.ndarray, " n"]) -> float:
    """Mean square error of a ridge regression on the rows that it is not fitted to."""
    features = features / (features[~held].std(0) + 1e-6)
    fitted = features[~held]
    gram = fitted.T @ fitted + RIDGE * len(fitted) * np.eye(features.shape[1])
    weights = np.linalg.solve(gram, fitted.T @ target[~held])
    return float(np.mean((features[held] @ weights - target[held]) ** 2))
