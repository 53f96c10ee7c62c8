"""Permutohedral lattice encoding: features on the vertices of a simplicial grid, hashed into tables.

Space is lifted to the plane sum(e) = 0 of R^4, which the lattice A3* (all-integer points of equal remainder mod 4)
divides into congruent tetrahedra (Adams et al. 2010, "Fast high-dimensional filtering using the permutohedral
lattice", section 3). Four vertices per point instead of the cube's eight, weights linear in the position, so the
derivative is constant inside a simplex (PermutoSDF, Rosu and Behnke 2023).

Vocabulary: e, lifted coordinates in units of the simplex; d, their offsets from the simplex's remainder-0 vertex,
over 4; rank[i], how many d are larger than d[i]; k, a vertex of the simplex (its remainder); idx[k], its row in the
table. Everything is kept as separate vectors of length n, one per coordinate: the layout in which the
compiler turns the whole search into one loop without temporaries.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

Vector = Float[Array, " n"]

VERTICES_PER_UNIT_VOLUME = 32.0 ** (1 / 3)
"""Lifted length that gives one vertex per unit volume: A3* scaled to integers has cells of volume 32."""

_PRIMES = np.array([2531011, 3674653429, 2097192037], np.uint64)


def _lift(x: Vector, y: Vector, z: Vector, scale: float) -> list[Vector]:
    """Coordinates in the plane sum = 0 of R^4; an isometry times `scale` (Adams 2010, figure 3)."""
    a, b, c = (v * np.float32(scale / np.sqrt((i + 1) * (i + 2))) for i, v in enumerate((x, y, z)))
    return [a + b + c, b + c - a, c - 2 * b, -3 * c]


def _lift_matrix(scale: float) -> np.ndarray:
    """(4, 3) matrix of `_lift`."""
    rows = np.array([[1, 1, 1], [-1, 1, 1], [0, -2, 1], [0, 0, -3]], np.float64)
    return rows * scale / np.sqrt([2.0, 6.0, 12.0])


def simplex(x: Vector, y: Vector, z: Vector, scale: float) -> tuple[list, list, list]:
    """The tetrahedron around each point.

    Returns:
        origin: 4 integer vectors, the remainder-0 vertex divided by 4.
        rank: 4 integer vectors, each a permutation of 0..3 per point.
        d: 4 float vectors, offsets from that vertex over 4, with max(d) - min(d) <= 1.
    """
    e = [v * np.float32(0.25) for v in _lift(x, y, z, scale)]
    rounded = [jnp.round(v) for v in e]
    d = [v - r for v, r in zip(e, rounded, strict=True)]
    excess = sum(rounded[1:], rounded[0]).astype(jnp.int32)
    rank = [jnp.zeros_like(excess) for _ in range(4)]
    for i in range(4):
        for j in range(i + 1, 4):
            smaller = (d[i] < d[j]).astype(jnp.int32)
            rank[i], rank[j] = rank[i] + smaller, rank[j] + 1 - smaller
    origin = []
    for i in range(4):  # rounding may have left the plane by `excess` steps: walk back along the largest offsets
        raw = rank[i] + excess
        wrap = (raw < 0).astype(jnp.int32) - (raw > 3).astype(jnp.int32)
        rank[i] = raw + 4 * wrap
        origin.append(rounded[i].astype(jnp.int32) + wrap)
        d[i] = d[i] - wrap
    return origin, rank, d


def barycentric(d: list[Vector]) -> list[Vector]:
    """Weights of the vertices k = 0..3 (Adams 2010, proposition 4.2): differences of the sorted offsets.

    A sorting network of five comparators stands for the sort.
    """
    a, b, c, e = d
    a, b = jnp.maximum(a, b), jnp.minimum(a, b)
    c, e = jnp.maximum(c, e), jnp.minimum(c, e)
    a, c = jnp.maximum(a, c), jnp.minimum(a, c)
    b, e = jnp.maximum(b, e), jnp.minimum(b, e)
    b, c = jnp.maximum(b, c), jnp.minimum(b, c)
    return [1 + e - a, c - e, b - c, a - b]


def _rows(origin: list, rank: list, log2_size: int) -> list[Int[Array, " n"]]:
    """Table rows of the four vertices: a linear hash of three coordinates, then a mixing step.

    Vertex k is 4 * origin + k, minus 4 in the coordinates whose rank exceeds 3 - k, so that its hash differs
    from the origin's by constants.
    """
    step = [np.uint32((4 * int(p)) % 2**32) for p in _PRIMES]
    base = sum((o.astype(jnp.uint32) * s for o, s in zip(origin[1:3], step[1:], strict=True)), origin[0].astype(jnp.uint32) * step[0])
    rows = []
    for k in range(4):
        key = base + np.uint32(k * int(_PRIMES.sum()) % 2**32)
        if k:
            for i in range(3):
                key = key - jnp.where(rank[i] > 3 - k, step[i], np.uint32(0))
        key = (key ^ (key >> np.uint32(15))) * np.uint32(2654435769)
        rows.append((key >> np.uint32(32 - log2_size)).astype(jnp.int32))
    return rows


def _gather(table: Float[Array, " size"], rows: Int[Array, " n"]) -> Vector:
    return table.at[rows].get(mode="promise_in_bounds")


@jax.custom_vjp
def _combine(table: Float[Array, "features size"], rows: list, coefficients: list) -> list:
    """For each set of four coefficients and each channel, the sum over the four vertices of coefficient times value.

    The weights give the interpolated value; sets of their slopes give its derivatives. Linear in the table; rows and
    coefficients are data.
    """
    channels = [jax.lax.optimization_barrier(channel) for channel in table]
    vertices = [[_gather(channel, row) for row in rows] for channel in channels]
    return [[sum(v * c for v, c in zip(vertex, one, strict=True)) for vertex in vertices] for one in coefficients]


def _combine_forward(table, rows, coefficients):
    return _combine(table, rows, coefficients), (table, rows, coefficients)


def _combine_backward(saved, cotangents):
    """One scatter per channel and level, into a table that fits the cache."""
    table, rows, coefficients = saved
    all_rows = jax.lax.optimization_barrier(jnp.concatenate(rows))
    table_bar = []
    for channel in range(table.shape[0]):
        per_vertex = [sum(one[k] * g[channel] for one, g in zip(coefficients, cotangents, strict=True)) for k in range(4)]
        update = jax.lax.optimization_barrier(jnp.concatenate(per_vertex))
        table_bar.append(jnp.zeros(table.shape[1], table.dtype).at[all_rows].add(update, mode="promise_in_bounds"))
    nothing = [np.zeros(row.shape, jax.dtypes.float0) for row in rows]
    return jnp.stack(table_bar), nothing, jax.tree.map(jnp.zeros_like, coefficients)


_combine.defvjp(_combine_forward, _combine_backward)


def weight_slopes(rank: list, scale: float) -> list[list[Vector]]:
    """Derivatives of the four vertex weights to x, y and z: three sets of four, constant inside a simplex.

    With the weights as differences of sorted offsets, offset i adds to vertex 3 - rank[i] and takes from vertex
    (4 - rank[i]) mod 4; the lift is linear.
    """
    lift = (_lift_matrix(scale) / 4).astype(np.float32)
    gains = [[jnp.where(r == 3 - k, 1.0, 0.0) - jnp.where(r == (4 - k) % 4, 1.0, 0.0) for r in rank] for k in range(4)]
    return [[sum(gain * lift[i, axis] for i, gain in enumerate(gains[k])) for k in range(4)] for axis in range(3)]


class PermutohedralLattice(eqx.Module):
    """Multi-resolution lattice over the cube [-1, 1]^3 (and as far beyond as one likes: rows are hashed).

    `resolutions[l]` is the number of vertices per unit length, as many per volume as a cubic grid of that spacing.
    """

    tables: tuple[Float[Array, "features size"], ...]
    resolutions: tuple[float, ...] = eqx.field(static=True)
    log2_size: int = eqx.field(static=True)

    @classmethod
    def create(cls, key: PRNGKeyArray, *, levels: int, features: int, log2_size: int, coarsest: float, finest: float):
        """Tables of uniform values within 1e-4; resolutions grow geometrically from `coarsest` to `finest`."""
        growth = (finest / coarsest) ** (1 / max(levels - 1, 1))
        keys = jax.random.split(key, levels)
        tables = tuple(jax.random.uniform(k, (features, 2**log2_size), minval=-1e-4, maxval=1e-4) for k in keys)
        return cls(tables, tuple(float(coarsest * growth**level) for level in range(levels)), log2_size)

    @property
    def num_channels(self) -> int:
        """Levels times features."""
        return len(self.tables) * self.tables[0].shape[0]

    def __call__(self, points: Float[Array, "3 n"], scale: Float[Array, " n"] | None = None) -> Float[Array, "channels n"]:
        """Features of points.

        Args:
            points: coordinates in the lattice's space.
            scale: standard deviation of the Gaussian that each point stands for; each level is weighted by
                the share of it that a cell holds (`ball_share`). None: points have no extent.
        """
        values, _ = self._evaluate(points, scale, with_slopes=False)
        return values

    def value_and_jacobian(
        self, points: Float[Array, "3 n"], scale: Float[Array, " n"] | None = None
    ) -> tuple[Float[Array, "channels n"], Float[Array, "channels 3 n"]]:
        """Features and their derivative to the position, which is constant inside a simplex.

        Both differentiable to the tables, neither to the points: where a field is looked at is data. Where the
        share of a level depends on `scale`, that share is held constant.
        """
        values, slopes = self._evaluate(points, scale, with_slopes=True)
        return values, jnp.stack(slopes, 1)

    def _evaluate(self, points, scale, *, with_slopes: bool):
        x, y, z = jax.lax.optimization_barrier(tuple(jax.lax.stop_gradient(points)))
        columns: list[list] = [[] for _ in range(4 if with_slopes else 1)]
        for table, resolution in zip(self.tables, self.resolutions, strict=True):
            rows, coefficients = self._located(x, y, z, scale, resolution, with_slopes)
            for column, channels in zip(columns, _combine(table, rows, coefficients), strict=True):
                column += channels
        values, *slopes = (jnp.stack(column) for column in columns)
        return values, slopes

    def _located(self, x, y, z, scale, resolution: float, with_slopes: bool):
        lifted = resolution * VERTICES_PER_UNIT_VOLUME
        origin, rank, d = jax.lax.optimization_barrier(simplex(x, y, z, lifted))
        coefficients = [barycentric(d)] + (weight_slopes(rank, lifted) if with_slopes else [])
        if scale is not None:
            share = ball_share(jax.lax.stop_gradient(scale), resolution)
            coefficients = [[c * share for c in one] for one in coefficients]
        return jax.lax.optimization_barrier((_rows(origin, rank, self.log2_size), coefficients))

    def decay(self) -> Float[Array, ""]:
        """Sum over levels of the mean square of the table's values (Zip-NeRF, Barron et al. 2023, section 3)."""
        return sum((jnp.mean(jnp.square(table)) for table in self.tables), jnp.zeros(()))


def ball_share(sigma: Float[Array, " n"], resolution: float) -> Float[Array, " n"]:
    """Share of an isotropic Gaussian inside the ball of radius sqrt(3) / (4 resolution), half a cube's half-diagonal.

        erf(q) - 2/sqrt(pi) q exp(-q^2),   q = radius / (sqrt(2) sigma),

    1 for a point and falling like q^3 for wide Gaussians.
    """
    q = np.sqrt(3) / (4 * resolution) / (np.sqrt(2) * jnp.maximum(sigma, 1e-12))
    q = jnp.minimum(q, 10.0)  # erf and exp are 1 and 0 to the last bit from there on
    return jax.lax.erf(q) - 2 / np.sqrt(np.pi) * q * jnp.exp(-q * q)
