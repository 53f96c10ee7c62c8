import jax
import jax.numpy as jnp
import numpy as np

from reconstruct.numerics.volume import volume_weights
from reconstruct.rendering.compositing import composite, sample_weights
from reconstruct.sampling.samples import RaySamples


def test_packed_samples_are_composited_per_ray() -> None:
    edges = jnp.sort(jax.random.uniform(jax.random.key(0), (6, 10)), -1) * 4
    samples, speed = RaySamples.from_edges(edges), jnp.linspace(1, 2, 6)
    density = jax.random.uniform(jax.random.key(1), (54,)) * 3
    weights = sample_weights(density, samples, speed)
    expected = volume_weights(density.reshape(6, 9), jnp.diff(edges) * speed[:, None])
    np.testing.assert_allclose(weights, expected, atol=1e-6)
    values = jax.random.normal(jax.random.key(2), (3, 54))
    expected = np.einsum("crs,rs->rc", np.asarray(values).reshape(3, 6, 9), weights)
    np.testing.assert_allclose(composite(values, samples.packed(weights), samples), expected, atol=1e-6)
