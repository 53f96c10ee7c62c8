"""The visual hull of the masks as the shape that a density begins with.

    log density = gain raw + clip(BORDER - distance / WIDTH, OUTSIDE, INSIDE)

While the gain is zero nothing moves the shape, and what a mirror shows is learned on nearly the right surface. A density that
begins as fog explains a mirror by what seems to be behind it, and keeps a hollow there.
"""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float16

from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.volume import SURFACE

GRID = 64
"""Points of the distance per axis of the object's cube."""
CELL = 2 / GRID
WIDTH = 0.02
"""Distance over which the density changes by a factor of e [scene unit]."""
BORDER, OUTSIDE, INSIDE = math.log(math.log(2) / SURFACE), -1.0, 5.3
"""Logarithm of the density on the hull, a surface there, far from it, and deep inside: opaque, but gaps can still be opened."""
LEAK = 1e-3
"""Slope beyond these bounds, as a share of that between them, so that there is a normal everywhere."""
NOWHERE = 1.0
"""Distance if there are no masks: thin fog everywhere [scene unit]."""


class Outline(eqx.Module):
    """Signed distance to the visual hull, negative inside, and how much the network adds to it. Nothing here is learned."""

    distance: Float16[Array, "x y z"]
    gain: Float[Array, ""]
    """What the network's raw density is multiplied by; see `Schedule.gain`."""

    @classmethod
    def of(cls, distance: Float[np.ndarray, "x y z"] | None) -> "Outline":
        """Of the `hull_distance` to masks; None: there are no masks."""
        known = np.full((GRID,) * 3, NOWHERE) if distance is None else distance
        return cls(jnp.asarray(known, jnp.float16), jnp.zeros(()))

    def log_density(self, raw: Float[Array, " n"], points: Float[Array, "3 n"]) -> Float[Array, " n"]:
        """Logarithm of the density [1 / scene unit] at points of the scene."""
        begun = BORDER - self._at(points) / WIDTH
        bounded = jnp.clip(begun, OUTSIDE, INSIDE)
        return self.gain * raw + barrier(bounded + LEAK * (begun - bounded))

    def slope(self, slope: Float[Array, "3 n"], points: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
        """Gradient of `log_density` from that of the raw density, the distance's over a cell to either side [1 / scene unit]."""
        begun = BORDER - self._at(points) / WIDTH
        factor = jnp.where((begun > OUTSIDE) & (begun < INSIDE), 1.0, LEAK) / WIDTH
        ends = points[:, None] + np.array([1, -1])[:, None, None, None] * (CELL * np.eye(3)[:, :, None])  # (2, 3, 3, n)
        ahead, behind = self._at(jnp.moveaxis(ends, 1, 0).reshape(3, -1)).reshape(2, 3, -1)
        return self.gain * slope - barrier(factor * (ahead - behind) / (2 * CELL))

    def _at(self, points: Float[Array, "3 n"]) -> Float[Array, " n"]:
        """The distance, trilinear between the grid's points; no gradient goes to the points."""
        place = jnp.clip((jax.lax.stop_gradient(points) + 1) / CELL - 0.5, 0, GRID - 1.001)
        corner = place.astype(jnp.int32)
        share, values, total = place - corner, self.distance.reshape(-1), jnp.zeros(points.shape[1])
        for x, y, z in itertools.product((0, 1), repeat=3):
            row = ((corner[0] + x) * GRID + corner[1] + y) * GRID + corner[2] + z
            weight = math.prod(share[i] if far else 1 - share[i] for i, far in enumerate((x, y, z)))
            total = total + weight * values[row].astype(jnp.float32)
        return total
