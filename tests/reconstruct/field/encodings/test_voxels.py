from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.encodings import tables
from koala3d.reconstruct.field.encodings.voxels import VoxelGrid, cube_share
from koala3d.reconstruct.numerics import lattice_constants
from tests import drawn

EVALUATE = jax.jit(lambda grid, points, scale=None: grid.value_and_jacobian(points, scale))


@pytest.fixture(scope="module")
def grid() -> VoxelGrid:
    """With values of order one, so that differences show."""
    sizes = {"levels": 3, "features": 2, "log2_size": 12, "coarsest": 2.0, "finest": 9.0}
    made = drawn.filled(lambda: VoxelGrid.create(jax.random.key(1), **sizes))
    return eqx.tree_at(lambda one: one.table, made, drawn.uniform(*made.table.shape, low=-1))


def hashed(vertex: np.ndarray, log2_size: int) -> int:
    """Row within a level's table of one vertex, with Python's own integers: the hash's definition."""
    key = sum(int(v) * p for v, p in zip(vertex, lattice_constants.PRIMES, strict=True)) % 2**32
    key = (key ^ (key >> 15)) * int(tables.MIXER) % 2**32
    return key >> (32 - log2_size)


def reference(grid: VoxelGrid, points: np.ndarray) -> np.ndarray:
    """(channels, n) features in float64, vertex by vertex, by tensor products of hat functions."""
    table = np.asarray(grid.table, np.float64).reshape(grid.table.shape[0], len(grid.resolutions), -1)
    result = np.zeros((grid.table.shape[0], len(grid.resolutions), points.shape[1]))
    for level, resolution in enumerate(grid.resolutions):
        for n, position in enumerate(np.asarray(points, np.float64).T * resolution):
            for offset in product((0, 1), repeat=3):
                vertex = np.floor(position) + offset
                weight = np.prod(1 - np.abs(position - vertex))
                result[:, level, n] += weight * table[:, level, hashed(vertex, grid.log2_size)]
    return result.reshape(-1, points.shape[1])


def test_features_equal_a_float64_reference(grid: VoxelGrid, points: jax.Array) -> None:
    np.testing.assert_allclose(EVALUATE(grid, points)[0], reference(grid, points), atol=1e-5)
    np.testing.assert_allclose(jax.jit(lambda g, p: g(p))(grid, points), EVALUATE(grid, points)[0], atol=1e-6)


def test_features_are_continuous_across_faces(grid: VoxelGrid) -> None:
    """On a vertex, an edge and a face of the coarsest level (resolution 2) both sides agree up to the step's slope."""
    at = np.array([[0.5, 0.5, 0.5], [0.5, -0.5, 0.1], [-0.5, 0.3, 0.2]]).T.astype(np.float32)
    step = 1e-5
    sides = np.concatenate(
        [at - np.float32(step), at + np.float32(step), np.zeros((3, 394), np.float32)], 1
    )  # of the points' shape
    before, after = np.split(np.asarray(EVALUATE(grid, sides)[0])[:, :6], 2, 1)
    steepest = 2 * 9 * np.sqrt(3)  # a difference of two values of order one across a cell of the finest level, along a diagonal
    np.testing.assert_allclose(before, after, atol=2 * step * np.sqrt(3) * steepest)


def test_jacobian_equals_differences(grid: VoxelGrid, points: jax.Array) -> None:
    """Trilinear: along an axis the reference is linear inside a cell, so that central differences are exact there."""
    step = 1e-4
    exact = np.asarray(points, np.float64)
    jacobian = np.asarray(EVALUATE(grid, points)[1])
    for axis in range(3):
        offset = step * np.eye(3)[axis][:, None]
        inside = np.ones(points.shape[1], bool)
        for resolution in grid.resolutions:
            inside &= (np.floor((exact - offset) * resolution) == np.floor((exact + offset) * resolution)).all(0)
        assert inside.sum() > 300
        difference = (reference(grid, exact[:, inside] + offset) - reference(grid, exact[:, inside] - offset)) / (2 * step)
        np.testing.assert_allclose(jacobian[:, axis, inside], difference, atol=1e-5 * np.abs(difference).max())


def test_the_table_s_gradient_equals_autodiff_of_the_obvious(grid: VoxelGrid, points: jax.Array) -> None:
    rows, coefficients = jax.jit(lambda g, p: g.located(p, None, with_slopes=True))(grid, points)
    assert len(rows) == 8 and [len(one) for one in coefficients] == [8] * 4
    cotangents = drawn.normal(4, 2, 3, points.shape[1])

    def ours(table):
        return jnp.sum(jnp.stack([jnp.stack(one) for one in tables.combine(table, rows, coefficients)]) * cotangents)

    def obvious(table):
        gathered, weights = table[:, jnp.stack(rows)], jnp.stack([jnp.stack(one) for one in coefficients])
        return jnp.sum(jnp.einsum("fkln,skln->sfln", gathered, weights) * cotangents)

    gradient, expected = (jax.jit(jax.grad(f))(grid.table) for f in (ours, obvious))
    np.testing.assert_allclose(gradient, expected, atol=1e-4 * np.abs(expected).max())  # float32 sums in two orders


def test_nothing_flows_back_to_points_and_scales(grid: VoxelGrid, points: jax.Array) -> None:
    scale = np.full(points.shape[1], 0.05, np.float32)
    for gradient in jax.jit(jax.grad(lambda p, s: jnp.sum(grid(p, s)), argnums=(0, 1)))(points, scale):
        np.testing.assert_array_equal(gradient, 0)


def test_share_is_the_gaussian_inside_a_cell() -> None:
    """Numerical integration of a normal density over [-1/2, 1/2] cells, wide and narrow."""
    resolution, sigmas = np.float32(16.0), np.array([1e-4, 0.003, 0.01, 0.03, 0.1, 1.0])
    half = 1 / (2 * resolution)
    x = ((np.arange(200_000) + 0.5) / 200_000 * 2 - 1) * half
    expected = [np.mean(np.exp(-(x**2) / (2 * s**2)) / np.sqrt(2 * np.pi * s**2)) * 2 * half for s in sigmas]
    assert expected[0] > 0.999 and expected[-1] < 0.03, "the sizes cover both ends"
    found = jax.jit(lambda s: cube_share(s, np.array([resolution])))(np.float32(sigmas))
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_wide_gaussians_and_the_blur_fade_level_by_level(grid: VoxelGrid, points: jax.Array) -> None:
    plain, plain_jacobian = map(np.asarray, EVALUATE(grid, points))
    blurred = eqx.tree_at(lambda g: g.blur, grid, drawn.array(0.03))
    share = jax.jit(lambda s: cube_share(s, np.float32(grid.resolutions)[:, None]))(np.float32([0.05]))
    share = np.tile(np.asarray(share)[:, 0], 2)
    assert share[0] > share[1] > share[2]
    # 0.03 and 0.04 together are 0.05, given per point or per axis
    for scale in (np.full(points.shape[1], 0.04, np.float32), np.full((3, points.shape[1]), 0.04, np.float32)):
        values, jacobian = EVALUATE(blurred, points, scale)
        np.testing.assert_allclose(values, plain * share[:, None], atol=1e-5)
        np.testing.assert_allclose(jacobian, plain_jacobian * share[:, None, None], rtol=1e-4, atol=1e-4)


def test_decay_is_the_slope_of_mean_squares_summed_over_levels(grid: VoxelGrid) -> None:
    squares = lambda table: jnp.sum(jnp.mean(jnp.square(table.reshape(2, 3, -1)), (0, 2)))  # noqa: E731
    np.testing.assert_allclose(grid.decay * grid.table, jax.grad(squares)(grid.table), rtol=1e-5)
    assert grid.num_channels == 6
