import jax
import jax.numpy as jnp
import numpy as np

from koala3d.reconstruct.numerics.volume import volume_weights
from koala3d.reconstruct.rendering.compositing import composite, sample_weights
from koala3d.reconstruct.sampling.samples import RaySamples
from tests import drawn


def test_packed_samples_are_composited_per_ray() -> None:
    edges = np.float32(np.sort(np.random.default_rng(0).uniform(0, 4, (6, 10)), -1))
    speed, density, values = np.linspace(1, 2, 6, dtype=np.float32), drawn.uniform(54, high=3), drawn.normal(3, 54)

    @jax.jit
    def composited(edges: jax.Array, speed: jax.Array, density: jax.Array, values: jax.Array) -> tuple[jax.Array, ...]:
        """Weights as packed and as tables, and sums of values."""
        samples = RaySamples.from_edges(edges)
        weights = sample_weights(density, samples, speed)
        expected = volume_weights(density.reshape(6, 9), jnp.diff(edges) * speed[:, None])
        return weights, expected, composite(values, samples.packed(weights), samples)

    weights, expected, sums = composited(edges, speed, density, values)
    np.testing.assert_allclose(weights, expected, atol=1e-6)
    np.testing.assert_allclose(sums, np.einsum("crs,rs->rc", np.asarray(values).reshape(3, 6, 9), weights), atol=1e-6)
