import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.encodings import simplex, tables
from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice, ball_share
from koala3d.reconstruct.numerics import lattice_constants
from koala3d.reconstruct.numerics.compiling import barrier
from tests import drawn

EVALUATE = jax.jit(lambda grid, points, scale=None: grid.value_and_jacobian(points, scale))
VALUE = jax.jit(lambda grid, points: grid(points))
LOCATE = jax.jit(lambda grid, points: grid.located(points, None, with_slopes=True))


@pytest.fixture(scope="module")
def grid() -> PermutohedralLattice:
    """With values of order one, so that differences show."""
    sizes = {"levels": 3, "features": 2, "log2_size": 12, "coarsest": 2.0, "finest": 9.0}
    made = drawn.filled(lambda: PermutohedralLattice.create(jax.random.key(1), **sizes))
    return eqx.tree_at(lambda one: one.table, made, drawn.uniform(*made.table.shape, low=-1))


def share_of(sigma: list[float], resolutions: list[float]) -> np.ndarray:
    """(resolutions, sigma) shares inside a cell's ball."""
    return np.asarray(jax.jit(lambda s: ball_share(s, np.float32(resolutions)[:, None]))(np.float32(sigma)))


@jax.jit
def found(points: jax.Array, scale: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Ranks (n, 4), and origins (n, 4) of the simplices around points."""
    e = barrier(simplex.lift(*(points * scale)))
    code = barrier(simplex.ordering(e))
    ranks = jnp.stack([simplex.rank_of(code, i) for i in range(4)], -1)
    return ranks, jnp.stack([simplex.origin_of(e, code, i) for i in range(4)], -1)


def corners_of(points: np.ndarray, resolution: float) -> tuple[np.ndarray, np.ndarray]:
    """(n, 4 vertices, 4 coordinates) integers and (n, 4) float64 lifted points at one level; test_simplex.py tests the search."""
    scale = resolution * simplex.VERTICES_PER_UNIT_VOLUME
    ranks, origins = map(np.asarray, found(np.float32(points), np.float32(scale)))
    corners = np.stack([4 * origins + k - 4 * (ranks > 3 - k) for k in range(4)], 1)
    return corners, np.asarray(points, np.float64).T @ (4 * scale * simplex.LIFT.T)


def hashed(corners: np.ndarray, log2_size: int) -> np.ndarray:
    """Rows within a level's table from whole vertices, with Python's own integers: the hash's definition."""
    rows = []
    for vertex in corners.reshape(-1, 4).tolist():
        key = sum(v * p for v, p in zip(vertex[:3], lattice_constants.PRIMES, strict=True)) % 2**32
        key = (key ^ (key >> 15)) * int(tables.MIXER) % 2**32
        rows.append(key >> (32 - log2_size))
    return np.array(rows).reshape(corners.shape[:-1])


def reference(grid: PermutohedralLattice, points: np.ndarray) -> np.ndarray:
    """(channels, n) features in float64, vertex by vertex: weights by solving for them, rows by the hash's definition."""
    table = np.asarray(grid.table, np.float64).reshape(grid.table.shape[0], len(grid.resolutions), -1)
    levels = []
    for level, resolution in enumerate(grid.resolutions):
        corners, lifted = corners_of(points, resolution)
        system = np.concatenate([corners.transpose(0, 2, 1), np.ones((len(corners), 1, 4))], 1)
        target = np.concatenate([lifted, np.ones((len(corners), 1))], -1)
        weights = np.einsum("nkc,nc->nk", np.linalg.pinv(system), target)
        levels.append(np.einsum("fnk,nk->fn", table[:, level][:, hashed(corners, grid.log2_size)], weights))
    return np.stack(levels, 1).reshape(-1, points.shape[1])


def test_features_equal_a_float64_reference(grid: PermutohedralLattice, points: jax.Array) -> None:
    np.testing.assert_allclose(
        EVALUATE(grid, points)[0], reference(grid, points), atol=3e-5
    )  # float32 at 9 * 3.2 * 1.5 = 43 lifted units
    np.testing.assert_allclose(VALUE(grid, points), EVALUATE(grid, points)[0], atol=3e-5)


def test_features_are_continuous_across_facets(grid: PermutohedralLattice) -> None:
    """Along a fine line features change by no more than the steepest slope times the step, though it crosses many facets."""
    t = np.linspace(-1, 1, 20001)
    line = (np.array([[0.3], [0.1], [-0.2]]) + np.array([[0.8], [-0.55], [0.37]]) * t).astype(np.float32)
    corners, _ = corners_of(line, grid.resolutions[-1])
    assert (np.diff(corners, axis=0) != 0).any((1, 2)).sum() > 50, "the line must cross facets"
    values, jacobian = map(np.asarray, EVALUATE(grid, line))
    steepest = np.linalg.norm(jacobian, axis=1).max(-1)
    step = np.linalg.norm(np.diff(line.astype(np.float64), axis=1), axis=0).max()
    assert (np.abs(np.diff(values, axis=1)).max(-1) <= steepest * step + 3e-5).all()  # + float32 rounding of the weights


def test_jacobian_equals_differences_inside_a_simplex(grid: PermutohedralLattice, points: jax.Array) -> None:
    """Linear inside a simplex: central differences of the float64 reference are exact as long as no facet is crossed."""
    step = 1e-3
    jacobian = np.asarray(EVALUATE(grid, points)[1])
    exact = np.asarray(points, np.float64)
    offsets = [sign * step * np.eye(3)[axis][:, None] for axis in range(3) for sign in (1, -1)]
    inside = np.ones(points.shape[1], bool)
    for resolution in grid.resolutions:
        here = corners_of(exact, resolution)[0]
        for offset in offsets:
            inside &= (corners_of(exact + 1.01 * offset, resolution)[0] == here).all((1, 2))
    assert inside.sum() > 50, "enough points must be far from facets at all levels"
    for axis in range(3):
        plus, minus = (reference(grid, exact + offset)[:, inside] for offset in offsets[2 * axis : 2 * axis + 2])
        difference = (plus - minus) / (2 * step)
        np.testing.assert_allclose(jacobian[:, axis, inside], difference, atol=2e-5 * np.abs(difference).max())


def test_own_derivative_rule_equals_autodiff_of_the_obvious(grid: PermutohedralLattice, points: jax.Array) -> None:
    rows, coefficients = LOCATE(grid, points)
    cotangents = drawn.normal(4, 2, 3, points.shape[1])

    def ours(table):
        return jnp.sum(jnp.stack([jnp.stack(one) for one in tables.combine(table, rows, coefficients)]) * cotangents)

    def obvious(table):
        gathered, weights = table[:, jnp.stack(rows)], jnp.stack([jnp.stack(one) for one in coefficients])
        return jnp.sum(jnp.einsum("fkln,skln->sfln", gathered, weights) * cotangents)

    (value, gradient), (expected, expected_gradient) = (jax.jit(jax.value_and_grad(f))(grid.table) for f in (ours, obvious))
    np.testing.assert_allclose(value, expected, rtol=1e-4)
    np.testing.assert_allclose(
        gradient, expected_gradient, atol=1e-4 * np.abs(expected_gradient).max()
    )  # float32 sums in two orders


def test_nothing_flows_back_to_the_points(grid: PermutohedralLattice, points: jax.Array) -> None:
    gradient = jax.jit(jax.grad(lambda p: jnp.sum(grid.value_and_jacobian(p)[0])))(points)
    assert not np.any(gradient)


@pytest.mark.parametrize("log2_size", [4, pytest.param(11, marks=pytest.mark.slow), 20])
def test_rows_are_in_their_level_s_table_and_spread_out(log2_size: int) -> None:
    far = drawn.uniform(3, 20000, low=-300, high=300)
    table = drawn.array(np.zeros((1, 2 << log2_size)))
    made = PermutohedralLattice(table, drawn.array(0.0), (1.0, 3.0), log2_size)
    rows = np.stack(LOCATE(made, far)[0])  # (vertex, level, n)
    within = rows - np.arange(2)[:, None] * 2**log2_size
    assert within.min() >= 0
    assert within.max() < 2**log2_size
    counts = np.bincount((within >> (log2_size - 4)).reshape(-1), minlength=16)
    expected = rows.size / 16
    # vertices repeat between neighbouring points, hence the allowance of twenty standard errors instead of five
    assert np.abs(counts - expected).max() < 20 * np.sqrt(expected)


def test_hash_keeps_nearby_vertices_apart() -> None:
    """As many collisions as random rows would have, not more: 2^18 rows for a few thousand vertices."""
    near = np.random.default_rng(4).uniform(-1, 1, (3, 20000)).astype(np.float32)
    vertices = np.unique(corners_of(near, 6.0)[0].reshape(-1, 4), axis=0)
    assert 1000 < len(vertices) < 40_000, "vertices must be shared between points"
    used, size = len(np.unique(hashed(vertices, 18))), 2.0**18
    expected = size * (1 - np.exp(-len(vertices) / size))
    assert used > expected - 5 * np.sqrt(len(vertices) ** 2 / (2 * size)) - 5


def test_share_is_the_gaussian_inside_the_ball() -> None:
    """Numerical integration of the radial density 4 pi r^2 N(r; sigma) over the ball of radius sqrt(3) / (4 resolution)."""
    resolution, sigmas = np.float32(16.0), np.array([1e-4, 0.003, 0.01, 0.03, 0.1, 1.0])
    radius = np.sqrt(3) / (4 * resolution)
    r = (np.arange(200_000) + 0.5) / 200_000 * radius
    expected = [
        np.sum(4 * np.pi * r**2 * np.exp(-(r**2) / (2 * s**2)) / (2 * np.pi * s**2) ** 1.5) * radius / len(r) for s in sigmas
    ]
    assert expected[0] > 0.999
    assert expected[-1] < 1e-3, "the sizes cover both ends"
    found = share_of([*sigmas, 0.0], [resolution])[0]
    np.testing.assert_allclose(found[:-1], expected, atol=1e-6)
    assert found[-1] == 1


def test_wide_gaussians_fade_level_by_level(grid: PermutohedralLattice, points: jax.Array) -> None:
    values, jacobian = EVALUATE(grid, points, np.full(points.shape[1], 0.05, np.float32))
    plain, plain_jacobian = map(np.asarray, EVALUATE(grid, points))
    share = np.tile(share_of([0.05], list(grid.resolutions))[:, 0], 2)
    assert share[0] > share[1] > share[2]
    np.testing.assert_allclose(values, plain * share[:, None], atol=1e-6)
    np.testing.assert_allclose(jacobian, plain_jacobian * share[:, None, None], rtol=1e-5, atol=1e-5)


def test_decay_is_the_slope_of_mean_squares_summed_over_levels(grid: PermutohedralLattice) -> None:
    squares = lambda table: jnp.sum(jnp.mean(jnp.square(table.reshape(2, 3, -1)), (0, 2)))  # noqa: E731
    np.testing.assert_allclose(grid.decay * grid.table, jax.grad(squares)(grid.table), rtol=1e-5)
    assert grid.num_channels == 6
    np.testing.assert_allclose(grid.resolutions, [2, np.sqrt(18), 9])
