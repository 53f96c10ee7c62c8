"""Voxel hash grid: features on the vertices of nested cubic grids, hashed into tables (Instant-NGP, Mueller et al. 2022).

The same tables, hash and rules of differentiation as the permutohedral lattice, with eight vertices around a point instead
of four and trilinear weights, whose derivative changes inside a cell.
"""

from itertools import product
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.field.encodings.encoding import blurred
from koala3d.reconstruct.field.encodings.grid import HashedGrid
from koala3d.reconstruct.field.encodings.tables import row_of, starts
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.lattice_constants import PRIMES

CORNERS = tuple(product((0, 1), repeat=3))
"""Offsets of a cell's vertices from its lowest one."""


class VoxelGrid(HashedGrid):
    """Cubic grid; levels are weighted by `cube_share`. Its derivative changes inside a cell."""

    def located(self, points, scale, *, with_slopes: bool) -> tuple[list, list]:
        """Rows of the eight vertices around each point and sets of eight coefficients, each (levels, n)."""
        units = np.array(self.resolutions, np.float32)[:, None]
        position = barrier([points[axis] * units for axis in range(3)])
        lowest = [jnp.floor(v) for v in position]
        upper = [v - low for v, low in zip(position, lowest, strict=True)]
        coefficients = [trilinear(upper)] + ([slopes(upper, units, axis) for axis in range(3)] if with_slopes else [])
        share = barrier(cube_share(blurred(self.blur, scale), units))
        coefficients = [[c * share for c in one] for one in coefficients]
        whole = [low.astype(jnp.int32) for low in lowest]
        return barrier((table_rows(whole, self.log2_size), coefficients))


def table_rows(lowest: list[Int[Array, "levels n"]], log2_size: int) -> list[Int[Array, "levels n"]]:
    """Rows of the eight vertices in the order of `CORNERS`: a linear hash of the coordinates, then a mixing step."""
    base = cast(Array, sum(v.astype(jnp.uint32) * np.uint32(p) for v, p in zip(lowest, PRIMES, strict=True)))
    start = starts(base.shape[0], log2_size)
    steps = [sum(offset * p for offset, p in zip(corner, PRIMES, strict=True)) % 2**32 for corner in CORNERS]
    return [row_of(base + np.uint32(step), log2_size) + start for step in steps]


def trilinear(upper: list[Float[Array, "levels n"]]) -> list[Float[Array, "levels n"]]:
    """Weights of the vertices in the order of `CORNERS`; `upper` is the offset from the lowest vertex, in cells."""
    sides = [(1 - v, v) for v in upper]
    return [sides[0][i] * sides[1][j] * sides[2][k] for i, j, k in CORNERS]


def slopes(upper: list[Float[Array, "levels n"]], units: Float[np.ndarray, "levels 1"], axis: int) -> list[Array]:
    """Derivatives of the weights to the coordinate `axis`."""
    sides = [(1 - v, v) for v in upper]
    sides[axis] = (-jnp.broadcast_to(units, upper[axis].shape), jnp.broadcast_to(units, upper[axis].shape))
    return [sides[0][i] * sides[1][j] * sides[2][k] for i, j, k in CORNERS]


def cube_share(sigma: Float[Array, " n"], resolution: Float[np.ndarray, "..."]) -> Float[Array, "... n"]:
    """Weight of a level for a Gaussian: erf(1 / (sqrt(8) sigma resolution)) (Zip-NeRF, equation 4).

    The share of a one-dimensional Gaussian that lies inside a cell centred on it; 1 for a point.
    """
    q = np.float32(1 / np.sqrt(8)) / (resolution * jnp.maximum(sigma, 1e-12))
    return jax.lax.erf(jnp.minimum(q, 10.0))  # 1 to the last bit from there on
