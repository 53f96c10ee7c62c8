"""Permutohedral lattice encoding: features on the vertices of nested simplicial grids, hashed into tables.

The simplex search is done once per sample for all levels; value and derivative use its rows and weights. The own
derivative rule never differentiates through the search: both are linear in the tables.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from reconstruct.encodings.encoding import Scale, blurred
from reconstruct.encodings.simplex import (
    VERTICES_PER_UNIT_VOLUME,
    barycentric,
    lift,
    ordering,
    origin_of,
    rank_of,
    weight_slopes,
)
from reconstruct.encodings.tables import PRIMES, combine, mean_squares, resolutions_between, row_of, start_values, starts


def table_rows(e: list, code: Int[Array, "levels n"], log2_size: int) -> list[Int[Array, "levels n"]]:
    """Rows of the four vertices in tables of 2^log2_size: a linear hash of three coordinates, then a mixing step.

    Vertex k is 4 * origin + k, minus 4 in the coordinates whose rank exceeds 3 - k, so that its hash differs from the
    origin's by constants. Level l's rows start at l * 2^log2_size.
    """
    steps = [np.uint32(4 * p % 2**32) for p in PRIMES]
    base = sum(origin_of(e, code, i).astype(jnp.uint32) * step for i, step in enumerate(steps))
    start = starts(code.shape[0], log2_size)
    rows = []
    for k in range(4):
        key = base + np.uint32(k * sum(PRIMES) % 2**32)
        if k:
            for i, step in enumerate(steps):
                key = key - jnp.where(rank_of(code, i) > 3 - k, step, np.uint32(0))
        rows.append(row_of(key, log2_size) + start)
    return rows


class PermutohedralLattice(eqx.Module):
    """Multi-resolution lattice over the cube [-1, 1]^3 (and as far beyond as one likes: rows are hashed).

    `resolutions[l]` is the number of vertices per unit length, as many per volume as a cubic grid of that spacing.
    """

    table: Float[Array, "features rows"]
    """Channels of all levels' tables, one level after the other."""
    blur: Float[Array, ""]
    """Standard deviation that every point has at least; see `Encoding`."""
    resolutions: tuple[float, ...] = eqx.field(static=True)
    log2_size: int = eqx.field(static=True)

    @classmethod
    def create(
        cls, key: PRNGKeyArray, *, levels: int, features: int, log2_size: int, coarsest: float, finest: float
    ) -> "PermutohedralLattice":
        """Tables of uniform values within 1e-4; resolutions grow geometrically from `coarsest` to `finest`."""
        table = start_values(key, features, levels, log2_size)
        return cls(table, jnp.zeros(()), resolutions_between(coarsest, finest, levels), log2_size)

    @property
    def num_channels(self) -> int:
        """Levels times features."""
        return len(self.resolutions) * self.table.shape[0]

    def __call__(self, points: Float[Array, "3 n"], scale: Scale | None = None) -> Float[Array, "channels n"]:
        """Features of points.

        Args:
            points: coordinates in the lattice's space.
            scale: standard deviation of the Gaussian that each point stands for; each level is weighted by
                the share of it that a cell holds (`ball_share`). None: points have no extent.
        """
        return self._evaluate(points, scale, with_slopes=False)[0]

    def value_and_jacobian(
        self, points: Float[Array, "3 n"], scale: Scale | None = None
    ) -> tuple[Float[Array, "channels n"], Float[Array, "channels 3 n"]]:
        """Features and their derivative to the position, which is constant inside a simplex.

        Both differentiable to the tables, neither to the points: where a field is looked at is data. Where the
        share of a level depends on `scale`, that share is held constant.
        """
        value, *slopes = self._evaluate(points, scale, with_slopes=True)
        return value, jnp.stack(slopes, 1)

    def _evaluate(self, points, scale, *, with_slopes: bool) -> list[Float[Array, "channels n"]]:
        """The value, and with slopes its derivatives to x, y and z."""
        rows, coefficients = self.located(jax.lax.stop_gradient(points), scale, with_slopes=with_slopes)
        return [jnp.concatenate(channels) for channels in combine(self.table, rows, coefficients)]

    def located(self, points, scale, *, with_slopes: bool) -> tuple[list, list]:
        """Rows of the four vertices around each point and sets of four coefficients, each (levels, n)."""
        units = np.array(self.resolutions, np.float32)[:, None] * np.float32(VERTICES_PER_UNIT_VOLUME)
        e = jax.lax.optimization_barrier(lift(*(points[axis] * units for axis in range(3))))
        code = jax.lax.optimization_barrier(ordering(e))
        coefficients = [barycentric(e, code)] + (weight_slopes(code, units) if with_slopes else [])
        resolution = np.array(self.resolutions, np.float32)[:, None]
        share = jax.lax.optimization_barrier(ball_share(blurred(self.blur, scale), resolution))
        coefficients = [[c * share for c in one] for one in coefficients]
        return jax.lax.optimization_barrier((table_rows(e, code, self.log2_size), coefficients))

    def decay(self) -> Float[Array, ""]:
        """Sum over levels of the mean square of the table's values (Zip-NeRF, Barron et al. 2023, section 3)."""
        return mean_squares(self.table, len(self.resolutions))


def ball_share(sigma: Float[Array, " n"], resolution: Float[np.ndarray, "..."]) -> Float[Array, "... n"]:
    """Share of an isotropic Gaussian inside the ball of radius sqrt(3) / (4 resolution), half a cube's half-diagonal.

        erf(q) - 2/sqrt(pi) q exp(-q^2),   q = radius / (sqrt(2) sigma),

    1 for a point and falling like q^3 for wide Gaussians.
    """
    q = np.float32(np.sqrt(3) / 4 / np.sqrt(2)) / (resolution * jnp.maximum(sigma, 1e-12))
    q = jnp.minimum(q, 10.0)  # erf and exp are 1 and 0 to the last bit from there on
    return jax.lax.erf(q) - np.float32(2 / np.sqrt(np.pi)) * q * jnp.exp(-q * q)
