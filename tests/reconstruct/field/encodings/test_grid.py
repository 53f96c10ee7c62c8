"""The way of a GPU through a table, row by row and with rows found anew, against that of a processor."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.encodings import grid as grids
from koala3d.reconstruct.field.encodings.grid import HashedGrid
from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice
from koala3d.reconstruct.field.encodings.voxels import VoxelGrid
from koala3d.reconstruct.kernels import native
from tests import drawn

POINTS = np.float32(np.random.default_rng(0).uniform(-1.2, 1.2, (3, 300)))


def results(grid: HashedGrid, scale: np.ndarray | None) -> list[Any]:
    """Value, value with slopes, and the gradient of a function of both to everything."""

    def loss(inputs: tuple[Any, ...]) -> tuple[jax.Array, Any]:
        grid, points, scale = inputs
        value, (again, slopes) = grid(points, scale), grid.value_and_jacobian(points, scale)
        weight = jnp.cos(jnp.arange(slopes.size)).reshape(slopes.shape)
        return jnp.sum(value**2) + jnp.sum(weight * slopes) + jnp.sum(again), (value, again, slopes)

    (_, found), gradient = jax.jit(jax.value_and_grad(loss, has_aux=True))((grid, POINTS, scale))
    return jax.tree.leaves((found, gradient))


@pytest.mark.parametrize(
    ("kind", "extended"),
    [
        (PermutohedralLattice, True),  # what differs between the two ways knows no kinds
        pytest.param(PermutohedralLattice, False, marks=pytest.mark.slow),
        pytest.param(VoxelGrid, False, marks=pytest.mark.slow),
        pytest.param(VoxelGrid, True, marks=pytest.mark.slow),
    ],
)
def test_both_ways_come_to_the_same(kind: type[HashedGrid], extended: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(native.SWITCH, "off")
    create = functools.partial(kind.create, levels=3, features=2, log2_size=8, coarsest=2.0, finest=64.0)
    made = drawn.filled(lambda: create(jax.random.key(1)))
    made = eqx.tree_at(lambda one: one.table, made, drawn.normal(*made.table.shape))
    scale = np.full(POINTS.shape[1], 0.05, np.float32) if extended else None
    expected = results(made, scale)
    monkeypatch.setattr(grids, "by_row", lambda: True)
    for one, other in zip(results(made, scale), expected, strict=True):  # sums of float32 in another order
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5 * float(np.max(np.abs(other), initial=0.0)))
