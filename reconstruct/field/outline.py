"""The visual hull of the masks as the shape that a density begins with.

    log density = gain raw + clip(BORDER - distance / WIDTH, OUTSIDE, INSIDE)
    logit of the diffuse colour = raw + logit of what the views of a place have in common

While the gain is zero nothing moves the shape, and a mirror's surroundings are learned on nearly the right surface. A density that
begins as fog explains a mirror by what seems to be behind it, and keeps a hollow there. On the right surface a reflection explains
paint as well as a diffuse colour does, and keeps it; so each place begins with its own diffuse colour.
"""

import itertools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float16
from numpy.typing import NDArray

GRID = 64
"""Points of the grids per axis of the object's cube, in the middles of as many cells."""
CELL = 2 / GRID
WIDTH = 0.02
"""Distance over which the density changes by a factor of e [scene unit]."""
BORDER, OUTSIDE, INSIDE = 3.0, -1.0, 5.0
"""Logarithm of the density on the hull, far from it, and deep inside: opaque, but gaps can still be opened."""
LEAK = 1e-3
"""Slope beyond these bounds, as a share of that between them, so that there is a normal everywhere."""
NOWHERE = 1.0
"""Distance if there is no hull: thin fog everywhere [scene unit]."""
DARKEST, BRIGHTEST = 0.01, 0.95
"""Bounds of a linear diffuse colour that a place begins with."""


class Hull(NamedTuple):
    """What masks and pictures say of the object's shape and colour; see `first_shape`."""

    distance: Float[NDArray[Any], "x y z"]
    """Signed distance to the hull, negative inside [scene unit]."""
    common: Float[NDArray[Any], "x y z 3"]
    """Linear colour that the views of the nearest place on the hull have in common."""


class Outline(eqx.Module):
    """Where the hull is, what colour it has, and how much the network adds to its shape. Nothing here is learned."""

    distance: Float16[Array, "x y z"]
    """Signed distance to the hull, negative inside [scene unit]."""
    paint: Float16[Array, "x y z 3"]
    """Added to the raw diffuse colour."""
    gain: Float[Array, ""]
    """What the network's raw density is multiplied by; see `Schedule.gain`."""

    @classmethod
    def of(cls, hull: Hull | None, diffuse_bias: float) -> "Outline":
        """With a gain of zero.

        Args:
            hull: None: there are no masks.
            diffuse_bias: what the appearance adds to the raw diffuse colour itself.
        """
        paint, distance = np.zeros((GRID,) * 3 + (3,)), np.full((GRID,) * 3, NOWHERE)
        if hull is not None:
            common, distance = np.clip(hull.common, DARKEST, BRIGHTEST), hull.distance
            paint = np.log(common / (1 - common)) - diffuse_bias
        return cls(jnp.asarray(distance, jnp.float16), jnp.asarray(paint, jnp.float16), jnp.zeros(()))

    def log_density(self, raw: Float[Array, " n"], points: Float[Array, "3 n"]) -> Float[Array, " n"]:
        """Logarithm of the density [1 / scene unit] at points of the scene."""
        begun = self._begun(points)
        bounded = jnp.clip(begun, OUTSIDE, INSIDE)
        return self.gain * raw + bounded + LEAK * (begun - bounded)

    def slope(self, slope: Float[Array, "3 n"], points: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
        """Gradient of `log_density` from that of the raw density, the distance's over a cell to either side [1 / scene unit]."""
        begun = self._begun(points)
        factor = jnp.where((begun > OUTSIDE) & (begun < INSIDE), 1.0, LEAK)
        ends = points[:, None] + np.array([1, -1])[:, None, None, None] * (CELL * np.eye(3)[:, :, None])  # (2, 3, 3, n)
        ahead, behind = self._begun(jnp.moveaxis(ends, 1, 0).reshape(3, -1)).reshape(2, 3, -1)
        return self.gain * slope + factor * (ahead - behind) / (2 * CELL)

    def painted(self, raw: Float[Array, "3 n"], points: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
        """The raw diffuse colour with that of the hull."""
        return raw + _interpolated(self.paint, points)

    def _begun(self, points: Float[Array, "3 n"]) -> Float[Array, " n"]:
        return BORDER - _interpolated(self.distance[..., None], points)[0] / WIDTH


def _interpolated(values: Float16[Array, "x y z k"], points: Float[Array, "3 n"]) -> Float[Array, "k n"]:
    """Trilinear between the grid's points; no gradient goes to the places."""
    place = jnp.clip((jax.lax.stop_gradient(points) + 1) / CELL - 0.5, 0, GRID - 1.001)
    corner = place.astype(jnp.int32)
    share, rows, total = place - corner, values.reshape(-1, values.shape[-1]), jnp.zeros((values.shape[-1], points.shape[1]))
    for x, y, z in itertools.product((0, 1), repeat=3):
        row = ((corner[0] + x) * GRID + corner[1] + y) * GRID + corner[2] + z
        weight = math.prod(share[i] if far else 1 - share[i] for i, far in enumerate((x, y, z)))
        total = total + weight * rows[row].astype(jnp.float32).T
    return total
