"""Hashed tables of features, whatever the grid whose vertices they belong to.

Vocabulary: a table holds the channels of all levels, one level after the other; log2_size, the number of rows of each level as
a power of two; rows and coefficients are lists with one (levels, n) array per vertex around a point.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt32

from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.lattice_constants import MIXER


def resolutions_between(coarsest: float, finest: float, levels: int) -> tuple[float, ...]:
    """`levels` numbers that grow geometrically from `coarsest` to `finest`."""
    growth = (finest / coarsest) ** (1 / max(levels - 1, 1))
    return tuple(float(coarsest * growth**level) for level in range(levels))


def start_values(key: PRNGKeyArray, features: int, levels: int, log2_size: int) -> Float[Array, "features rows"]:
    """A table of uniform values within 1e-4."""
    return jax.random.uniform(key, (features, levels * 2**log2_size), minval=-1e-4, maxval=1e-4)


def starts(levels: int, log2_size: int) -> Int[np.ndarray, "levels 1"]:
    """First row of each level."""
    return np.arange(levels, dtype=np.int32)[:, None] << log2_size


def row_of(key: UInt32[Array, "levels n"], log2_size: int) -> Int[Array, "levels n"]:
    """Row within its level of a vertex whose coordinates were hashed linearly: a mixing step, then the upper bits."""
    key = (key ^ (key >> np.uint32(15))) * MIXER
    return (key >> np.uint32(32 - log2_size)).astype(jnp.int32)


def combine(table: Float[Array, "features rows"], rows: list, coefficients: list) -> list:
    """For each set of coefficients and each channel, the sum over the vertices of coefficient times value.

    The weights give the interpolated value; sets of their slopes give its derivatives. Linear in the table; rows
    and coefficients are data, each (levels, n).
    """
    channels = [barrier(channel) for channel in table]
    vertices = [[channel.at[row].get(mode="promise_in_bounds") for row in rows] for channel in channels]
    return [[sum(v * c for v, c in zip(vertex, one, strict=True)) for vertex in vertices] for one in coefficients]


def combine_rows(table: Float[Array, "features rows"], rows: list, coefficients: list) -> list:
    """The same by reading all features of a row at once: a GPU fetches 32 bytes wherever it reads, eight numbers or one."""
    by_row = _adjacent(table.T)
    vertices = [by_row.at[row].get(mode="promise_in_bounds") for row in rows]
    products = [[v * c[..., None] for v, c in zip(vertices, one, strict=True)] for one in coefficients]
    sums = [_adjacent(sum(one[1:], one[0])) for one in products]
    return [[one[..., feature] for feature in range(table.shape[0])] for one in sums]


def spread(shape: tuple[int, int], rows: list, coefficients: list, cotangents: list) -> Float[Array, "features rows"]:
    """Gradient of `combine` to a table of this shape.

    One scatter per channel; ordered by level, so that it works in the part of the table that is in the cache.
    """
    all_rows = barrier(jnp.stack(rows, 1).reshape(-1))
    table_bar = []
    for channel in range(shape[0]):
        per_vertex = [sum(one[k] * g[channel] for one, g in zip(coefficients, cotangents, strict=True)) for k in range(len(rows))]
        update = barrier(jnp.stack(per_vertex, 1).reshape(-1))
        table_bar.append(jnp.zeros(shape[1], update.dtype).at[all_rows].add(update, mode="promise_in_bounds"))
    return jnp.stack(table_bar)


def spread_rows(shape: tuple[int, int], rows: list, coefficients: list, cotangents: list) -> Float[Array, "features rows"]:
    """The same with all features of a row added at once, one vertex after the other."""
    pulled = [_adjacent(jnp.stack(one, -1)) for one in cotangents]
    by_row = _adjacent(jnp.zeros(shape[::-1], pulled[0].dtype))
    for vertex, row in enumerate(rows):
        update = sum(one[vertex][..., None] * pull for one, pull in zip(coefficients, pulled, strict=True))
        by_row = by_row.at[row].add(update, mode="promise_in_bounds")
    return _adjacent(by_row).T


def _adjacent(array: Float[Array, "... n features"]) -> Float[Array, "... n features"]:
    """The same with all features of a row side by side in memory; left to itself the compiler keeps each feature's in one piece.

    The order within one axis is not the compiler's to choose.
    """
    return barrier(array.reshape(*array.shape[:-2], -1)).reshape(array.shape)
