"""Permutohedral lattice encoding: features on the vertices of nested simplicial grids, hashed into tables.

The simplex search is done once per sample for all levels; value and derivative use its rows and weights. The own
derivative rule never differentiates through the search: both are linear in the tables.
"""

from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.field.encodings.encoding import Scale, blurred
from koala3d.reconstruct.field.encodings.grid import HashedGrid
from koala3d.reconstruct.field.encodings.simplex import (
    VERTICES_PER_UNIT_VOLUME,
    barycentric,
    lift,
    ordering,
    origin_of,
    rank_of,
    weight_slopes,
)
from koala3d.reconstruct.field.encodings.tables import row_of, starts
from koala3d.reconstruct.kernels import native
from koala3d.reconstruct.kernels.encoding import encode
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.lattice_constants import PRIMES


def table_rows(e: list, code: Int[Array, "levels n"], log2_size: int) -> list[Int[Array, "levels n"]]:
    """Rows of the four vertices in the levels' tables: a linear hash of three coordinates, then a mixing step.

    Vertex k is 4 * origin + k, minus 4 in the coordinates whose rank exceeds 3 - k, so that its hash differs from the
    origin's by constants.
    """
    steps = [np.uint32(4 * p % 2**32) for p in PRIMES]
    base = cast(Array, sum(origin_of(e, code, i).astype(jnp.uint32) * step for i, step in enumerate(steps)))
    start = starts(base.shape[0], log2_size)
    rows = []
    for k in range(4):
        key = base + np.uint32(k * sum(PRIMES) % 2**32)
        if k:
            for i, step in enumerate(steps):
                key = key - jnp.where(rank_of(code, i) > 3 - k, step, np.uint32(0))
        rows.append(row_of(key, log2_size) + start)
    return rows


class PermutohedralLattice(HashedGrid):
    """Simplicial grid; levels are weighted by `ball_share`. Its derivative is constant inside a simplex."""

    def __call__(self, points: Float[Array, "3 n"], scale: Scale | None = None) -> Float[Array, "channels n"]:
        """See `HashedGrid`; by compiled loops where they can run."""
        if native.usable(points, self.table):
            return self._encoded(points, scale, with_slopes=False)[0]
        return super().__call__(points, scale)

    def value_and_jacobian(
        self, points: Float[Array, "3 n"], scale: Scale | None = None
    ) -> tuple[Float[Array, "channels n"], Float[Array, "channels 3 n"]]:
        """See `HashedGrid`; by compiled loops where they can run."""
        if native.usable(points, self.table):
            value, slopes = self._encoded(points, scale, with_slopes=True)
            assert slopes is not None
            return value, slopes
        return super().value_and_jacobian(points, scale)

    def _encoded(
        self, points: Float[Array, "3 n"], scale: Scale | None, *, with_slopes: bool
    ) -> tuple[Float[Array, "channels n"], Float[Array, "channels 3 n"] | None]:
        resolution = np.array(self.resolutions, np.float32)
        share = ball_share(blurred(self.blur, scale), resolution[:, None])
        units = resolution * np.float32(VERTICES_PER_UNIT_VOLUME)
        first = starts(len(self.resolutions), self.log2_size)[:, 0]
        sizes = np.stack([np.full_like(first, self.log2_size), first])
        place = (jax.lax.stop_gradient(points), share, units, sizes)
        return encode(self.table, *place, with_slopes=with_slopes, onto=self.onto)

    def located(self, points, scale, *, with_slopes: bool) -> tuple[list, list]:
        """Rows of the four vertices around each point and sets of four coefficients, each (levels, n)."""
        units = np.array(self.resolutions, np.float32)[:, None] * np.float32(VERTICES_PER_UNIT_VOLUME)
        e = barrier(lift(*(points[axis] * units for axis in range(3))))
        code = barrier(ordering(e))
        coefficients = [barycentric(e, code)] + (weight_slopes(code, units) if with_slopes else [])
        resolution = np.array(self.resolutions, np.float32)[:, None]
        share = barrier(ball_share(blurred(self.blur, scale), resolution))
        coefficients = [[c * share for c in one] for one in coefficients]
        return barrier((table_rows(e, code, self.log2_size), coefficients))


def ball_share(sigma: Float[Array, " n"], resolution: Float[np.ndarray, "..."]) -> Float[Array, "... n"]:
    """Share of an isotropic Gaussian inside the ball of radius sqrt(3) / (4 resolution), half a cube's half-diagonal.

        erf(q) - 2/sqrt(pi) q exp(-q^2),   q = radius / (sqrt(2) sigma),

    1 for a point and falling like q^3 for wide Gaussians, where the series to q^11 stands for a difference that cancels.
    """
    q = np.float32(np.sqrt(3) / 4 / np.sqrt(2)) / (resolution * jnp.maximum(sigma, 1e-12))
    q = jnp.minimum(q, 10.0)  # erf and exp are 1 and 0 to the last bit from there on
    difference = jax.lax.erf(q) - np.float32(2 / np.sqrt(np.pi)) * q * jnp.exp(-q * q)
    square = jnp.minimum(q, 1.0) ** 2
    series = np.float32(2 / np.sqrt(np.pi)) * (2 / 3 - square * (2 / 5 - square * (1 / 7 - square * (1 / 27 - square / 132))))
    return jnp.where(q < 0.4, q**3 * series, difference)
