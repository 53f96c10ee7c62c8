"""How far the views of a place on an object agree on its light: on paint, highlights apart, and not on what a metal mirrors.

Of an object that was turned over before its lamps, the views of one session are compared with one another.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from koala3d.datasets.imaging.images import linear_from_srgb
from koala3d.reconstruct.scene.rays import Pixels
from koala3d.reconstruct.training.decisions.evidence.hull_points import hull_points, pixel_width

PIXELS = 30_000
"""Pixels that are looked at, at most."""
CELLS, CELLS_OF_SESSIONS = 48, 32
"""Places on the object: cells of the cube per axis; larger ones where a session has but a part of the pixels."""
FEWEST, LEAST_PLACES = 8, 100
"""Pixels of a place, and places, that say anything."""
FEWEST_VIEWS = 6
"""Views of a session that are compared: a place in fewer is mostly seen from one direction."""
GRAZING = 0.3
"""Cosine to the camera below which a pixel is not used."""
LOW, HIGH = 0.2, 0.8
"""Quantiles that are compared: highlights are brighter than the upper one."""
DARK = 1e-3
"""Added to linear light that something is divided by."""


def sessions(turned: Float[np.ndarray, "views 3 3"] | None) -> Int[np.ndarray, " views"] | None:
    """Which views have the same rotation to the lamps' axes: numbers from 0, -1 of those with fewer than `FEWEST_VIEWS`.

    None where hardly any do, so that lamps move from view to view.
    """
    if turned is None:
        return None
    _, of, counts = np.unique(np.round(turned.reshape(-1, 9), 4), axis=0, return_inverse=True, return_counts=True)
    of = of.reshape(-1)
    many = counts[of] >= FEWEST_VIEWS
    return np.where(many, of, -1) if many.mean() > 0.5 else None


def agreement(
    pixels: Pixels, possible: Bool[np.ndarray, " cells"], session: Int[np.ndarray, " views"] | None = None
) -> float | None:
    """How far the views of a place agree on its light: the 20 % by the 80 % quantile, in the middle of all places, 0..1.

    None where too little is seen.

    Args:
        possible: cells of the object's cube that masks leave.
        session: of each view, see `sessions`; None: lamps stand still before all of them.
    """
    chosen = np.random.default_rng(0).permutation(np.flatnonzero(np.asarray(pixels.colour[:, 3]) > 0.99))[:PIXELS]
    rays, colour = pixels.take(jnp.asarray(np.sort(chosen)))
    viewdirs, origins = (np.asarray(values, np.float64) for values in (rays.viewdirs, rays.origins))
    points, normals = hull_points(origins, viewdirs, possible, pixel_width(rays))
    of, size = (np.zeros(len(points), int), CELLS) if session is None else (session[np.asarray(rays.view)], CELLS_OF_SESSIONS)
    seen = (-np.sum(normals * viewdirs, -1) > GRAZING) & (of >= 0)
    light = linear_from_srgb(np.clip(np.asarray(colour)[seen, :3], 0, None)).mean(-1)
    cells = np.clip((points[seen] + 1) / 2 * size, 0, size - 1).astype(int)
    low, high = _quantiles(of[seen] * size**3 + np.ravel_multi_index(tuple(cells.T), (size,) * 3), light)
    return float(np.median(low / (high + DARK))) if len(low) >= LEAST_PLACES else None


def _quantiles(
    place: Int[np.ndarray, " n"], light: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " places"], Float[np.ndarray, " places"]]:
    """`LOW` and `HIGH` quantile of the light of each place that has enough pixels."""
    order = np.lexsort((light, place))
    _, first, count = np.unique(place[order], return_index=True, return_counts=True)
    first, count = first[count >= FEWEST], count[count >= FEWEST]
    low, high = (light[order][first + np.round(share * (count - 1)).astype(int)] for share in (LOW, HIGH))
    return low, high
