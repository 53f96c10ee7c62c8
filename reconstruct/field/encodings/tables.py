"""Hashed tables of features, whatever the grid whose vertices they belong to.

Vocabulary: a table holds the channels of all levels, one level after the other; log2_sizes, the number of rows of each level as
a power of two; rows and coefficients are lists with one (levels, n) array per vertex around a point.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt32

from reconstruct.numerics.compiling import barrier
from reconstruct.numerics.lattice_constants import MIXER

HEADROOM, SMALLEST = 4, 8
"""Rows per vertex that a small table has, so that few of them share one; and its smallest size, as a power of two."""


def resolutions_between(coarsest: float, finest: float, levels: int) -> tuple[float, ...]:
    """`levels` numbers that grow geometrically from `coarsest` to `finest`."""
    growth = (finest / coarsest) ** (1 / max(levels - 1, 1))
    return tuple(float(coarsest * growth**level) for level in range(levels))


def fitting_sizes(resolutions: tuple[float, ...], log2_size: int, volume: float | None) -> tuple[int, ...]:
    """Rows of each level as a power of two: at most `log2_size`, fewer where so many vertices do not exist.

    Args:
        volume: where anything can be [scene unit^3]; None takes full tables.
    """
    if volume is None:
        return (log2_size,) * len(resolutions)
    vertices = (volume ** (1 / 3) * np.array(resolutions) + 1) ** 3
    wanted = np.ceil(np.log2(HEADROOM * vertices)).astype(int)
    return tuple(int(size) for size in np.clip(wanted, min(log2_size, SMALLEST), log2_size))


def start_values(key: PRNGKeyArray, features: int, log2_sizes: tuple[int, ...]) -> Float[Array, "features rows"]:
    """A table of uniform values within 1e-4."""
    return jax.random.uniform(key, (features, sum(2**size for size in log2_sizes)), minval=-1e-4, maxval=1e-4)


def mean_squares(table: Float[Array, "features rows"], log2_sizes: tuple[int, ...]) -> Float[Array, ""]:
    """Sum over levels of the mean square of the values (Zip-NeRF, Barron et al. 2023, section 3)."""
    squares = jnp.square(table)
    if len(set(log2_sizes)) == 1:
        return len(log2_sizes) * jnp.mean(squares)
    ends = np.cumsum([2**size for size in log2_sizes])
    return sum((jnp.mean(part) for part in jnp.split(squares, ends[:-1], 1)), jnp.zeros(()))


def starts(log2_sizes: tuple[int, ...]) -> Int[np.ndarray, "levels 1"]:
    """First row of each level."""
    return np.cumsum([0, *(2**size for size in log2_sizes[:-1])], dtype=np.int32)[:, None]


def row_of(key: UInt32[Array, "levels n"], log2_sizes: tuple[int, ...]) -> Int[Array, "levels n"]:
    """Row within its level of a vertex whose coordinates were hashed linearly: a mixing step, then the upper bits."""
    key = (key ^ (key >> np.uint32(15))) * MIXER
    return (key >> (32 - np.array(log2_sizes, np.uint32))[:, None]).astype(jnp.int32)


@jax.custom_vjp
def combine(table: Float[Array, "features rows"], rows: list, coefficients: list) -> list:
    """For each set of coefficients and each channel, the sum over the vertices of coefficient times value.

    The weights give the interpolated value; sets of their slopes give its derivatives. Linear in the table; rows
    and coefficients are data, each (levels, n).
    """
    channels = [barrier(channel) for channel in table]
    vertices = [[channel.at[row].get(mode="promise_in_bounds") for row in rows] for channel in channels]
    return [[sum(v * c for v, c in zip(vertex, one, strict=True)) for vertex in vertices] for one in coefficients]


def _combine_forward(table, rows, coefficients):
    return combine(table, rows, coefficients), (table, rows, coefficients)


def _combine_backward(saved, cotangents):
    """One scatter per channel; ordered by level, so that it works in the part of the table that is in the cache."""
    table, rows, coefficients = saved
    all_rows = barrier(jnp.stack(rows, 1).reshape(-1))
    table_bar = []
    for channel in range(table.shape[0]):
        per_vertex = [sum(one[k] * g[channel] for one, g in zip(coefficients, cotangents, strict=True)) for k in range(len(rows))]
        update = barrier(jnp.stack(per_vertex, 1).reshape(-1))
        table_bar.append(jnp.zeros(table.shape[1], table.dtype).at[all_rows].add(update, mode="promise_in_bounds"))
    nothing = [np.zeros(row.shape, jax.dtypes.float0) for row in rows]
    return jnp.stack(table_bar), nothing, jax.tree.map(jnp.zeros_like, coefficients)


combine.defvjp(_combine_forward, _combine_backward)
