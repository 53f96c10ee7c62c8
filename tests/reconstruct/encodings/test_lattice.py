import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import erf

from reconstruct.encodings import lattice
from reconstruct.encodings.lattice import PermutohedralLattice, ball_share, barycentric, weight_slopes

SCALE = 3.7


@pytest.fixture(scope="module")
def points() -> jax.Array:
    """(3, 400) points of [-1.5, 1.5]^3, float32."""
    return jnp.asarray(np.random.default_rng(0).uniform(-1.5, 1.5, (3, 400)), jnp.float32)


def simplex(points: np.ndarray, scale: float) -> tuple[list, list, list]:
    return lattice.simplex(*jnp.asarray(points, jnp.float32), scale)


def lifted(points: np.ndarray, scale: float) -> np.ndarray:
    """(n, 4) float64 coordinates in the plane, by the matrix."""
    return np.asarray(points, np.float64).T @ lattice._lift_matrix(scale).T


def vertices(origin: list, rank: list) -> np.ndarray:
    """(n, 4 vertices, 4 coordinates) integers of the simplex that `simplex` names."""
    origin, rank = np.stack(origin, -1), np.stack(rank, -1)
    return np.stack([4 * origin + k - 4 * (rank > 3 - k) for k in range(4)], 1)


def is_lattice_point(v: np.ndarray) -> np.ndarray:
    """All coordinates of equal remainder mod 4 and of sum zero: the definition of A3*, times four."""
    return (v.sum(-1) == 0) & (v % 4 == v[..., :1] % 4).all(-1)


def nearby_lattice_points(e: np.ndarray) -> np.ndarray:
    """Every point of the scaled A3* whose coordinates lie within 4 of those of e, by enumeration."""
    ranges = [range(int(np.floor(c)) - 4, int(np.ceil(c)) + 5) for c in e]
    candidates = np.array(list(itertools.product(*ranges[:3])))
    candidates = np.concatenate([candidates, -candidates.sum(-1, keepdims=True)], -1)
    return candidates[is_lattice_point(candidates) & (np.abs(candidates - e).max(-1) <= 4)]


def test_the_lift_is_an_isometry_times_its_scale(points: jax.Array) -> None:
    matrix = lattice._lift_matrix(SCALE)
    np.testing.assert_allclose(matrix.T @ matrix, SCALE**2 * np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.ones(4) @ matrix, 0, atol=1e-12)
    np.testing.assert_allclose(np.stack(lattice._lift(*points, SCALE), -1), lifted(points, SCALE), atol=4e-6)  # float32 of size 10


def test_vertices_are_lattice_points_and_weights_reproduce_the_point(points: jax.Array) -> None:
    origin, rank, d = simplex(points, SCALE)
    corners = vertices(origin, rank)
    assert is_lattice_point(corners).all()
    np.testing.assert_array_equal(np.sort(np.stack(rank), 0), np.arange(4)[:, None] * np.ones((1, points.shape[1])))
    weights = np.stack(barycentric(d), -1)
    assert weights.min() >= -1e-6  # float32 rounding of coordinates of size 10, over 4
    np.testing.assert_allclose(weights.sum(-1), 1, atol=1e-6)
    np.testing.assert_allclose(np.einsum("nk,nkc->nc", weights, corners), lifted(points, SCALE), atol=1e-5)


def test_the_simplex_is_the_delaunay_cell_found_by_enumeration(points: jax.Array) -> None:
    """A3*'s simplices are its Delaunay cells (Conway and Sloane 1988): no other lattice point lies within the circumsphere."""
    origin, rank, _ = simplex(points, SCALE)
    for e, corners in zip(lifted(points, SCALE)[:60], vertices(origin, rank)[:60], strict=True):
        a = 2 * (corners[1:] - corners[0])
        b = (corners[1:] ** 2).sum(-1) - (corners[0] ** 2).sum()
        centre = np.linalg.lstsq(np.vstack([a, np.ones(4)]), np.append(b, 0), rcond=None)[0]
        radius = np.linalg.norm(corners - centre, axis=-1)
        np.testing.assert_allclose(radius, radius[0], atol=1e-9)
        near = nearby_lattice_points(e)
        assert len(near) > 8, "the enumeration must offer alternatives"
        distance = np.linalg.norm(near - centre, axis=-1)
        assert distance.min() >= radius[0] - 1e-9
        inside = np.linalg.lstsq(np.vstack([corners.T, np.ones(4)]), np.append(e, 1), rcond=None)[0]
        assert inside.min() >= -1e-5, "the point lies in the cell"


@pytest.fixture(scope="module")
def grid() -> PermutohedralLattice:
    made = PermutohedralLattice.create(jax.random.key(1), levels=3, features=2, log2_size=12, coarsest=2.0, finest=9.0)
    return jax.tree.map(lambda table: table * 1e4, made)  # values of order one, so that differences show


def reference(grid: PermutohedralLattice, points: np.ndarray) -> np.ndarray:
    """(channels, n) features in float64, vertex by vertex, with rows from the lattice's own hash."""
    columns = []
    for table, resolution in zip(grid.tables, grid.resolutions, strict=True):
        scale = resolution * lattice.VERTICES_PER_UNIT_VOLUME
        origin, rank, _ = simplex(points, scale)
        rows = np.stack(lattice._rows(origin, rank, grid.log2_size))
        corners = vertices(origin, rank).astype(np.float64)
        system = np.concatenate([corners.transpose(0, 2, 1), np.ones((len(corners), 1, 4))], 1)
        target = np.concatenate([lifted(points, scale), np.ones((len(corners), 1))], -1)
        weights = np.stack([np.linalg.lstsq(s, t, rcond=None)[0] for s, t in zip(system, target, strict=True)])
        columns += [np.einsum("kn,nk->n", np.asarray(channel, np.float64)[rows], weights) for channel in table]
    return np.stack(columns)


def test_features_equal_a_float64_reference(grid: PermutohedralLattice, points: jax.Array) -> None:
    np.testing.assert_allclose(grid(points), reference(grid, points), atol=3e-5)  # float32 at 9 * 3.2 * 1.5 = 43 lifted units


def test_features_are_continuous_across_facets(grid: PermutohedralLattice) -> None:
    """Along a fine line features change by no more than the steepest slope times the step, though it crosses many facets."""
    t = np.linspace(-1, 1, 20001)
    line = (np.array([[0.3], [0.1], [-0.2]]) + np.array([[0.8], [-0.55], [0.37]]) * t).astype(np.float32)
    origin, rank, _ = simplex(line, grid.resolutions[-1] * lattice.VERTICES_PER_UNIT_VOLUME)
    crossings = (np.diff(np.stack([*origin, *rank]), axis=1) != 0).any(0).sum()
    assert crossings > 50, "the line must cross facets"
    values, jacobian = grid.value_and_jacobian(jnp.asarray(line))
    steepest = np.linalg.norm(jacobian, axis=1).max(-1)
    step = np.linalg.norm(np.diff(line.astype(np.float64), axis=1), axis=0).max()
    assert (np.abs(np.diff(values, axis=1)).max(-1) <= steepest * step + 3e-5).all()  # + float32 rounding of the weights


def test_jacobian_equals_differences_inside_a_simplex(grid: PermutohedralLattice, points: jax.Array) -> None:
    """Linear inside a simplex: central differences of the float64 reference are exact as long as no facet is crossed."""
    step = 1e-3
    _, jacobian = grid.value_and_jacobian(points)
    inside = np.ones(points.shape[1], bool)
    for resolution in grid.resolutions:
        _, _, d = simplex(points, resolution * lattice.VERTICES_PER_UNIT_VOLUME)
        inside &= np.stack(barycentric(d)).min(0) > 2 * step * resolution * lattice.VERTICES_PER_UNIT_VOLUME
    assert inside.sum() > 50, "enough points must be far from facets at all levels"
    chosen = np.asarray(points, np.float64)[:, inside]
    for axis in range(3):
        offset = np.eye(3)[axis][:, None] * step
        # reference() names simplices from float32 points: chosen so far from facets that rounding cannot move them over one
        difference = (reference(grid, chosen + offset) - reference(grid, chosen - offset)) / (2 * step)
        np.testing.assert_allclose(np.asarray(jacobian)[:, axis, inside], difference, atol=2e-5 * np.abs(difference).max() + 1e-5)


def test_own_derivative_rule_equals_autodiff_of_the_obvious(points: jax.Array) -> None:
    table = jax.random.normal(jax.random.key(2), (2, 64))
    origin, rank, d = simplex(points, SCALE)
    rows = lattice._rows(origin, rank, 6)
    coefficients = [barycentric(d), *weight_slopes(rank, SCALE)]
    cotangents = jax.random.normal(jax.random.key(3), (4, 2, points.shape[1]))

    def ours(table):
        return jnp.sum(jnp.stack([jnp.stack(c) for c in lattice._combine(table, rows, coefficients)]) * cotangents)

    def obvious(table):
        return jnp.sum(jnp.einsum("fkn,skn->sfn", table[:, jnp.stack(rows)], jnp.stack([jnp.stack(c) for c in coefficients])) * cotangents)

    np.testing.assert_allclose(ours(table), obvious(table), rtol=1e-4)
    np.testing.assert_allclose(jax.grad(ours)(table), jax.grad(obvious)(table), atol=1e-4)  # sums of 400 terms of order 1


def test_nothing_flows_back_to_the_points(grid: PermutohedralLattice, points: jax.Array) -> None:
    gradient = jax.grad(lambda p: jnp.sum(grid.value_and_jacobian(p)[0]))(points)
    np.testing.assert_array_equal(gradient, 0)


@pytest.mark.parametrize("log2_size", [4, 11, 24])
def test_rows_are_in_range_spread_out_and_the_same_from_every_simplex(log2_size: int) -> None:
    far = np.random.default_rng(3).uniform(-300, 300, (3, 20000)).astype(np.float32)
    origin, rank, _ = simplex(far, SCALE)
    rows = np.stack(lattice._rows(origin, rank, log2_size), -1)
    assert rows.min() >= 0
    assert rows.max() < 2**log2_size
    counts = np.bincount((rows >> max(log2_size - 4, 0)).reshape(-1), minlength=16)
    expected = rows.size / 16
    # vertices repeat between neighbouring points, hence the allowance of twenty standard errors instead of five
    assert np.abs(counts - expected).max() < 20 * np.sqrt(expected)
    near = np.random.default_rng(4).uniform(-1, 1, (3, 5000)).astype(np.float32)
    origin, rank, _ = simplex(near, SCALE)
    flat, row = vertices(origin, rank).reshape(-1, 4), np.stack(lattice._rows(origin, rank, log2_size), -1).reshape(-1)
    seen: dict[tuple, int] = {}
    assert all(seen.setdefault(tuple(v), r) == r for v, r in zip(flat.tolist(), row.tolist(), strict=True))
    assert len(seen) < len(row) / 10, "vertices must be shared between points"


def test_hash_keeps_nearby_vertices_apart() -> None:
    """As many collisions as random rows would have, not more: 2^18 rows for a few thousand vertices."""
    near = np.random.default_rng(4).uniform(-1, 1, (3, 20000)).astype(np.float32)
    origin, rank, _ = simplex(near, 20.0)
    flat, row = vertices(origin, rank).reshape(-1, 4), np.stack(lattice._rows(origin, rank, 18), -1).reshape(-1)
    distinct = len(np.unique(flat, axis=0))
    assert distinct > 1000
    used, size = len(np.unique(row)), 2.0**18
    expected = size * (1 - np.exp(-distinct / size))
    assert used > expected - 5 * np.sqrt(distinct**2 / (2 * size)) - 5


def test_vertices_edges_and_facets_have_defined_values(grid: PermutohedralLattice) -> None:
    scale = grid.resolutions[0] * lattice.VERTICES_PER_UNIT_VOLUME
    inverse = np.linalg.pinv(lattice._lift_matrix(scale))
    corners = np.array([[0, 0, 0, 0], [1, 1, 1, -3], [2, 2, -2, -2], [3, -1, -1, -1], [4, 0, 0, -4]], float)
    exact = np.concatenate([corners, (corners[:-1] + corners[1:]) / 2, (corners[:3] + corners[1:4] + corners[[3, 3, 4]]) / 3])
    values, jacobian = grid.value_and_jacobian(jnp.asarray((exact @ inverse.T).T, jnp.float32))
    assert np.isfinite(values).all()
    assert np.isfinite(jacobian).all()
    _, _, d = simplex((exact @ inverse.T).T, scale)
    weights = np.stack(barycentric(d), -1)
    np.testing.assert_allclose(np.sort(weights[:5], -1), [[0, 0, 0, 1]] * 5, atol=1e-6)
    np.testing.assert_allclose(weights.sum(-1), 1, atol=1e-6)


def test_share_is_the_gaussian_inside_the_ball() -> None:
    """Numerical integration of the radial density 4 pi r^2 N(r; sigma) over the ball of radius sqrt(3) / (4 resolution)."""
    resolution, sigmas = 16.0, np.array([1e-4, 0.003, 0.01, 0.03, 0.1, 1.0])
    radius = np.sqrt(3) / (4 * resolution)
    r = (np.arange(200_000) + 0.5) / 200_000 * radius
    expected = [np.sum(4 * np.pi * r**2 * np.exp(-(r**2) / (2 * s**2)) / (2 * np.pi * s**2) ** 1.5) * radius / len(r) for s in sigmas]
    np.testing.assert_allclose(ball_share(jnp.asarray(sigmas, jnp.float32), resolution), expected, atol=1e-6)
    assert erf(1.0) > 0.8 > expected[3], "the sizes cover both ends"
    assert ball_share(jnp.zeros(1), resolution)[0] == 1


def test_wide_gaussians_fade_level_by_level(grid: PermutohedralLattice, points: jax.Array) -> None:
    sigma = jnp.full(points.shape[1], 0.05)
    values, jacobian = grid.value_and_jacobian(points, sigma)
    plain, plain_jacobian = grid.value_and_jacobian(points)
    share = np.repeat([ball_share(sigma[:1], r)[0] for r in grid.resolutions], 2)
    assert share[0] > share[2] > share[4]
    np.testing.assert_allclose(values, plain * share[:, None], atol=1e-6)
    np.testing.assert_allclose(jacobian, plain_jacobian * share[:, None, None], rtol=1e-5, atol=1e-5)


def test_decay_sums_mean_squares_of_levels(grid: PermutohedralLattice) -> None:
    np.testing.assert_allclose(grid.decay(), sum(np.mean(np.asarray(t, np.float64) ** 2) for t in grid.tables), rtol=1e-5)
    assert grid.num_channels == 6
    np.testing.assert_allclose(grid.resolutions, [2, np.sqrt(18), 9])
