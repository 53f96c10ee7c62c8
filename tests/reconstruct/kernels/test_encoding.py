"""The lattice by compiled loops against `HashedGrid` in plain JAX, and against float64."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.encodings.grid import HashedGrid
from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice
from koala3d.reconstruct.numerics.compiling import jit
from tests import drawn

pytestmark = pytest.mark.usefixtures("kernels_run")

MOST = 2**15
"""Points that the twin computes at once: it is compiled for no other number, and fewer of them are the first of these."""


def lattice(levels: int = 3, features: int = 2, log2_size: int = 10) -> PermutohedralLattice:
    """With values of order one."""
    create = PermutohedralLattice.create
    made = drawn.filled(
        lambda: create(jax.random.key(0), levels=levels, features=features, log2_size=log2_size, coarsest=2.0, finest=64.0)
    )
    table, blur = drawn.normal(*made.table.shape, seed=2), drawn.array(0.0)
    return eqx.tree_at(lambda one: (one.table, one.blur), made, (table, blur))


def points_of(count: int) -> jax.Array:
    return drawn.uniform(3, count, low=-1.2, high=1.2)


def bars_of(grid: PermutohedralLattice, count: int) -> tuple[jax.Array, jax.Array]:
    """Cotangents of values, and of values with slopes."""
    return drawn.normal(grid.num_channels, count, seed=3), drawn.normal(grid.num_channels, 3, count, seed=4)


@jit
def native_of(grid: Any, points: jax.Array, scale: Any, bars: Any) -> tuple[Any, Any]:
    """Value and value with slopes; and the gradients of both to the table."""
    put = lambda table: eqx.tree_at(lambda one: one.table, grid, table)  # noqa: E731
    value, back = jax.vjp(lambda table: put(table)(points, scale), grid.table)
    both, back_both = jax.vjp(lambda table: put(table).value_and_jacobian(points, scale), grid.table)
    return (value, both), (back(bars[0])[0], back_both((bars[0], bars[1]))[0])


@jit
def twin_of(grid: Any, points: jax.Array, scale: Any, bars: Any) -> tuple[Any, Any]:
    """The same in plain JAX."""
    put = lambda table: eqx.tree_at(lambda one: one.table, grid, table)  # noqa: E731
    value, back = jax.vjp(lambda table: HashedGrid.__call__(put(table), points, scale), grid.table)
    both, back_both = jax.vjp(lambda table: HashedGrid.value_and_jacobian(put(table), points, scale), grid.table)
    return (value, both), (back(bars[0])[0], back_both((bars[0], bars[1]))[0])


def assert_alike(
    grid: PermutohedralLattice, points: jax.Array, scale: jax.Array | None = None, *, count: int | None = None
) -> None:
    """For the first points, if there is a `count`: nothing comes back to the twin from the others."""
    most = points.shape[1]
    count = most if count is None else count
    bars = bars_of(grid, most)
    ours = native_of(grid, np.asarray(points)[:, :count], scale, tuple(np.asarray(bar)[..., :count] for bar in bars))
    values, gradients = twin_of(grid, points, scale, tuple(np.where(np.arange(most) < count, bar, 0.0) for bar in bars))
    theirs = jax.tree.map(lambda one: np.asarray(one)[..., :count], values), gradients
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert one.shape == other.shape
        largest = float(np.max(np.abs(other)))  # sums of float32 in another order: 1e-5 of the largest
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5 * largest)


@pytest.mark.parametrize("count", [1, 257, MOST, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 255, 256, 5000))])
def test_values_slopes_and_gradients_are_those_of_the_twin(count: int) -> None:
    assert_alike(lattice(), points_of(MOST), count=count)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2**17, 2**20])
def test_large_batches(count: int) -> None:
    assert_alike(lattice(levels=2, log2_size=14), points_of(count))


@pytest.mark.parametrize(
    ("levels", "features"), [(1, 4), (9, 1), *(pytest.param(*sizes, marks=pytest.mark.slow) for sizes in ((1, 1), (9, 3)))]
)
def test_any_number_of_levels_and_features(levels: int, features: int) -> None:
    """Every point has its own extent."""
    grid = lattice(levels, features, log2_size=12)
    assert_alike(grid, points_of(300), drawn.array(10 ** np.random.default_rng(5).uniform(-4, 0, 300)))


def test_hard_places() -> None:
    """On facets, edges and vertices too: both round alike, and so find the same simplex."""
    rng = np.random.default_rng(1)
    hard = rng.choice(np.float32([0.0, -0.0, 0.25, 0.5, -1.0, 1.0, 1e-30]), (3, MOST))
    assert_alike(lattice(), np.where(rng.random((3, MOST)) < 0.5, hard, rng.uniform(-4, 4, (3, MOST))).astype(np.float32))


def test_values_are_near_those_of_float64() -> None:
    grid, points = lattice(), points_of(257)
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda a: drawn.array(a, np.float64), (grid, points))
        expected = jit(HashedGrid.__call__)(*exact)
        assert expected.dtype == jnp.float64
    (found, _), _ = native_of(grid, points, None, bars_of(grid, 257))
    np.testing.assert_allclose(found, expected, atol=1e-7 * 64 * 32)  # 1 ulp of a position of 1.2 times 64, times the slope


@pytest.mark.parametrize("compiled", [True, False])
def test_a_gradient_is_added_to_another_one(compiled: bool) -> None:
    """Of values, and of values with slopes: the gradient so far and the plain gradient, which is in another memory."""
    grid, points = lattice(), points_of(300)
    bars = bars_of(grid, 300)
    before = eqx.tree_at(lambda one: one.table, grid, drawn.normal(*grid.table.shape, seed=7))
    gradients = native_of if compiled else twin_of
    alone, added = (gradients(one, points, None, bars)[1] for one in (grid, grid.adding_to(before)))
    for one, other in zip(alone, added, strict=True):  # sums of float32 in another order
        np.testing.assert_allclose(other, one + before.table, atol=1e-5 * float(np.abs(one).max()))


def test_runs_repeat_to_the_bit() -> None:
    grid, points = lattice(8, log2_size=14), points_of(8192)
    bars = bars_of(grid, 8192)
    first = native_of(grid, points, None, bars)
    for _ in range(20):
        for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(native_of(grid, points, None, bars)), strict=True):
            np.testing.assert_array_equal(one, other)


def test_no_points_are_no_problem() -> None:
    grid = lattice()
    (value, _), gradients = native_of(grid, np.zeros((3, 0), np.float32), None, bars_of(grid, 0))
    assert value.shape == (6, 0) and not np.any(gradients)
