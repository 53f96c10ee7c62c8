"""The lattice by compiled loops against `HashedGrid` in plain JAX, and against float64."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reconstruct.field.encodings.grid import HashedGrid
from reconstruct.field.encodings.lattice import PermutohedralLattice

pytestmark = pytest.mark.usefixtures("kernels_run")

BARRIERS = {"xla_disable_hlo_passes": "cse_barrier_expander"}
jit = functools.partial(jax.jit, compiler_options=BARRIERS)
"""As training is compiled: with optimisation, unlike other tests, since products and sums are joined only then."""


def lattice(levels: int = 3, features: int = 2, log2_size: int = 10, volume: float | None = None) -> PermutohedralLattice:
    """With values of order one."""
    made = PermutohedralLattice.create(
        jax.random.key(1), levels=levels, features=features, log2_size=log2_size, coarsest=2.0, finest=64.0, volume=volume
    )
    return eqx.tree_at(lambda one: one.table, made, jax.random.normal(jax.random.key(2), made.table.shape))


def points_of(count: int, seed: int = 0) -> jax.Array:
    return jax.random.uniform(jax.random.key(seed), (3, count), minval=-1.2, maxval=1.2)


@jit
def native_of(grid: Any, points: jax.Array, scale: Any, bars: Any) -> tuple[Any, Any, Any]:
    """Value, value with slopes, and the gradients of both to the table."""
    put = lambda table: eqx.tree_at(lambda one: one.table, grid, table)  # noqa: E731
    value, back = jax.vjp(lambda table: put(table)(points, scale), grid.table)
    both, back_both = jax.vjp(lambda table: put(table).value_and_jacobian(points, scale), grid.table)
    return value, both, (back(bars[0])[0], back_both(bars)[0])


@jit
def twin_of(grid: Any, points: jax.Array, scale: Any, bars: Any) -> tuple[Any, Any, Any]:
    """The same in plain JAX."""
    put = lambda table: eqx.tree_at(lambda one: one.table, grid, table)  # noqa: E731
    value, back = jax.vjp(lambda table: HashedGrid.__call__(put(table), points, scale), grid.table)
    both, back_both = jax.vjp(lambda table: HashedGrid.value_and_jacobian(put(table), points, scale), grid.table)
    return value, both, (back(bars[0])[0], back_both(bars)[0])


def assert_alike(grid: PermutohedralLattice, points: jax.Array, scale: jax.Array | None = None) -> None:
    channels, count = grid.num_channels, points.shape[1]
    bars = jax.random.normal(jax.random.key(3), (channels, count)), jax.random.normal(jax.random.key(4), (channels, 3, count))
    ours, theirs = native_of(grid, points, scale, bars), twin_of(grid, points, scale, bars)
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert one.shape == other.shape
        largest = float(jnp.max(jnp.abs(other), initial=0.0))  # sums of float32 in another order: 1e-5 of the largest
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5 * largest)


@pytest.mark.parametrize("count", [1, 257, 5000, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 255, 256))])
def test_values_slopes_and_gradients_are_those_of_the_twin(count: int) -> None:
    assert_alike(lattice(), points_of(count))


@pytest.mark.parametrize("count", [2**17, pytest.param(2**20, marks=pytest.mark.slow)])
def test_large_batches(count: int) -> None:
    assert_alike(lattice(levels=2, log2_size=14), points_of(count))


@pytest.mark.parametrize(("levels", "features"), [(1, 1), (1, 4), (9, 3)])
def test_any_number_of_levels_and_features(levels: int, features: int) -> None:
    assert_alike(lattice(levels, features), points_of(300))


def test_levels_of_several_sizes() -> None:
    grid = lattice(4, log2_size=12, volume=0.02)
    assert len(set(grid.log2_sizes)) > 1
    assert_alike(grid, points_of(500))


def test_every_point_may_have_its_own_extent() -> None:
    assert_alike(lattice(), points_of(400), 10 ** jax.random.uniform(jax.random.key(5), (400,), minval=-4, maxval=0))


numbers = st.floats(-4, 4, width=32) | st.sampled_from([0.0, -0.0, 0.25, 0.5, -1.0, 1.0, 1e-30])


@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=7, max_size=7))
def test_hard_places(places: list[tuple[float, float, float]]) -> None:
    """On facets, edges and vertices too: both round alike, and so find the same simplex."""
    assert_alike(lattice(), jnp.asarray(places, jnp.float32).T)


def test_values_are_near_those_of_float64() -> None:
    grid, points = lattice(levels=2), points_of(200)
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda a: jnp.asarray(a, jnp.float64), grid)
        expected = exact(jnp.asarray(points, jnp.float64))
    # 1 ulp of a position of 1.2 times the resolution, 64, times the slope
    np.testing.assert_allclose(jit(lambda g, p: g(p))(grid, points), expected, atol=1e-7 * 64 * 32)


def test_runs_repeat_to_the_bit() -> None:
    grid, points = lattice(8, log2_size=14), points_of(8192)
    bars = jax.random.normal(jax.random.key(3), (16, 8192)), jax.random.normal(jax.random.key(4), (16, 3, 8192))
    first = native_of(grid, points, None, bars)
    for _ in range(20):
        for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(native_of(grid, points, None, bars)), strict=True):
            np.testing.assert_array_equal(one, other)


def test_no_points_are_no_problem() -> None:
    grid = lattice()
    assert grid(jnp.zeros((3, 0))).shape == (6, 0)
    gradient = jax.grad(lambda table: jnp.sum(eqx.tree_at(lambda one: one.table, grid, table)(jnp.zeros((3, 0)))))(grid.table)
    assert not gradient.any()
