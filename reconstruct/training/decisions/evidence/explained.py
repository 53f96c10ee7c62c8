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

from koala3d.datasets.imaging.images import linear_from_srgb
from koala3d.datasets.scene import View
from koala3d.reconstruct.scene.light import LightFrame
from koala3d.reconstruct.scene.rays import Pixels
from koala3d.reconstruct.training.decisions.evidence.hull_points import hull_points, pixel_width

PIXELS, FEWEST = 20_000, 2_000
"""Pixels that are fitted, at most and at least."""
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
    points, normals = hull_points(origins, viewdirs, possible, pixel_width(rays))
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


def _left_out(features: Float[np.ndarray, "n terms"], target: Vectors, held: Bool[np.ndarray, " n"]) -> float:
    """Mean square error of a ridge regression on the rows that it is not fitted to."""
    features = features / (features[~held].std(0) + 1e-6)
    fitted = features[~held]
    gram = fitted.T @ fitted + RIDGE * len(fitted) * np.eye(features.shape[1])
    weights = np.linalg.solve(gram, fitted.T @ target[~held])
    return float(np.mean((features[held] @ weights - target[held]) ** 2))
