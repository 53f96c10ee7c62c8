import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.numerics.volume import SURFACE, optical_depth, volume_weights
from koala3d.reconstruct.rendering.compositing import composited, lost_at, packed_depth
from koala3d.reconstruct.sampling.samples import RaySamples
from tests import drawn


@pytest.mark.parametrize("solidity", [0.0, 1.0])
def test_packed_samples_are_composited_per_ray(solidity: float) -> None:
    edges = np.float32(np.sort(np.random.default_rng(0).uniform(0, 4, (6, 10)), -1))
    speed, density, values = np.linspace(1, 2, 6, dtype=np.float32), drawn.uniform(54, high=3), drawn.normal(3, 54)

    @jax.jit
    def weights_and_sums(edges: jax.Array, speed: jax.Array, density: jax.Array, values: jax.Array) -> tuple[jax.Array, ...]:
        """Weights as packed and as tables, and sums of values."""
        samples = RaySamples.from_edges(edges)
        weights, sums = composited(packed_depth(density, samples, speed, solidity), (values,), samples)
        rows = density.reshape(6, 9)
        before = jnp.pad(rows[:, :-1], ((0, 0), (1, 0)))
        expected = volume_weights(optical_depth(rows, before, jnp.diff(edges) * speed[:, None], solidity=solidity))
        return weights, expected, sums[2:].T

    weights, expected, sums = weights_and_sums(edges, speed, density, values)
    np.testing.assert_allclose(weights, expected, atol=1e-6)
    np.testing.assert_allclose(sums, np.einsum("crs,rs->rc", np.asarray(values).reshape(3, 6, 9), weights), atol=1e-6)


def test_entries_that_only_fill_the_list_are_behind_nothing() -> None:
    rows = jnp.ones((2, 3))
    samples = RaySamples.in_rows(rows, rows, jnp.array([1, 3]))
    found = packed_depth(jnp.asarray([4.0, 9.0, 9.0, 2.0, 5.0, 3.0]), samples, rows[:, 0], 1.0)
    np.testing.assert_allclose(found, SURFACE * np.array([4, 0, 0, 2, 3, 0]))


def test_an_object_rises_from_nothing_where_fog_ends() -> None:
    """The density of the fog in front of its box is not that of the object."""
    row = jnp.ones((1, 4))
    samples = RaySamples.in_rows(row, row, jnp.array([4]))
    solidity = jnp.array([0.0, 1.0, 1.0, 0.0])
    found = packed_depth(jnp.asarray([5.0, 4.0, 9.0, 2.0]), samples, row[:, 0], solidity)
    np.testing.assert_allclose(found, [5, 4 * SURFACE, 5 * SURFACE, 2], rtol=1e-6)
    np.testing.assert_allclose(lost_at(jnp.array([2.0, 2.0]), jnp.array([1.0, 1.0]), jnp.array([0.0, 1.0])), [2.0, 1.5])
