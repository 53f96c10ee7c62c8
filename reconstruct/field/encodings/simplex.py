"""Which simplex of the permutohedral lattice holds a point, and with which weights.

Space is lifted to the plane sum(e) = 0 of R^4, which the lattice A3* (integer points of equal remainder mod 4)
divides into congruent tetrahedra (Adams et al. 2010, "Fast high-dimensional filtering using the permutohedral
lattice", section 3). Four vertices per point instead of the cube's eight, weights linear in the position, so that the
derivative is constant inside a simplex (PermutoSDF, Rosu and Behnke 2023).

Vocabulary: e, lifted coordinates over 4; d, their offsets from the simplex's remainder-0 vertex, over 4; rank[i],
how many d are larger than d[i]; k, a vertex of the simplex (its remainder). Coordinates are separate arrays
of one shape, in practice (levels, n): the layout in which the compiler makes one loop of the whole search.
"""

from typing import cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.numerics.lattice_constants import LIFT

Coordinate = Float[Array, "..."]

VERTICES_PER_UNIT_VOLUME = 32.0 ** (1 / 3)
"""Lifted length that gives one vertex per unit volume: A3* scaled to integers has cells of volume 32."""


def lift(x: Coordinate, y: Coordinate, z: Coordinate) -> list[Coordinate]:
    """The four lifted coordinates e of points given in units of the lattice."""
    return [cast(Array, sum(np.float32(row[axis]) * v for axis, v in enumerate((x, y, z)) if row[axis])) for row in LIFT]


def ordering(e: list[Coordinate]) -> Int[Array, "..."]:
    """All ranks and the steps from the rounded point to the simplex's remainder-0 vertex, packed into one integer.

    Two bits per rank, then two bits per step (plus one). One array is one loop: four of each would search anew for
    every one of them.
    """
    rounded = [jnp.round(v) for v in e]
    d = [v - r for v, r in zip(e, rounded, strict=True)]
    excess = sum(rounded[1:], rounded[0]).astype(jnp.int32)
    rank = [jnp.zeros_like(excess) for _ in range(4)]
    for i in range(4):
        for j in range(i + 1, 4):
            smaller = (d[i] < d[j]).astype(jnp.int32)
            rank[i], rank[j] = rank[i] + smaller, rank[j] + 1 - smaller
    code = jnp.zeros_like(excess)
    for i in range(4):  # rounding may have left the plane by `excess` steps: walk back along the largest offsets
        raw = rank[i] + excess
        step = (raw < 0).astype(jnp.int32) - (raw > 3).astype(jnp.int32)
        code = code | ((raw + 4 * step) << (2 * i)) | ((step + 1) << (8 + 2 * i))
    return code


def rank_of(code: Int[Array, "..."], i: int) -> Int[Array, "..."]:
    """rank[i], 0..3."""
    return (code >> (2 * i)) & 3


def step_of(code: Int[Array, "..."], i: int) -> Int[Array, "..."]:
    """Step of coordinate i from the rounded point to the remainder-0 vertex: -1, 0 or 1."""
    return ((code >> (8 + 2 * i)) & 3) - 1


def origin_of(e: list[Coordinate], code: Int[Array, "..."], i: int) -> Int[Array, "..."]:
    """Coordinate i of the remainder-0 vertex, over 4."""
    return jnp.round(e[i]).astype(jnp.int32) + step_of(code, i)


def barycentric(e: list[Coordinate], code: Int[Array, "..."]) -> list[Coordinate]:
    """Weights of the vertices k = 0..3 (Adams 2010, proposition 4.2): differences of the sorted offsets.

    A sorting network of five comparators stands for the sort.
    """
    a, b, c, d = (v - jnp.round(v) - step_of(code, i) for i, v in enumerate(e))
    a, b = jnp.maximum(a, b), jnp.minimum(a, b)
    c, d = jnp.maximum(c, d), jnp.minimum(c, d)
    a, c = jnp.maximum(a, c), jnp.minimum(a, c)
    b, d = jnp.maximum(b, d), jnp.minimum(b, d)
    b, c = jnp.maximum(b, c), jnp.minimum(b, c)
    return [1 + d - a, c - d, b - c, a - b]


def weight_slopes(code: Int[Array, "..."], scale: Float[np.ndarray, "..."]) -> list[list[Coordinate]]:
    """Derivatives of the four weights to x, y and z: three sets of four, constant inside a simplex.

    Offset i adds to the weight of vertex 3 - rank[i] and takes from that of vertex (4 - rank[i]) mod 4; the lift is linear.

    Args:
        scale: units of the lattice per unit of x, y and z.
    """
    sets: list[list[Coordinate]] = [[], [], []]
    for k in range(4):
        gains = [
            jnp.where(rank_of(code, i) == 3 - k, 1.0, 0.0) - jnp.where(rank_of(code, i) == (4 - k) % 4, 1.0, 0.0)
            for i in range(4)
        ]
        for axis in range(3):
            slope = cast(Array, sum(gain * np.float32(LIFT[i, axis]) for i, gain in enumerate(gains) if LIFT[i, axis]))
            sets[axis].append(cast(Array, scale * slope))
    return sets
