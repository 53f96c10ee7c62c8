import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.numerics.volume import volume_weights


def reference(density: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Two plain loops in float64: light that reaches an interval, times the share that the interval keeps."""
    weights = np.zeros_like(density, np.float64)
    for ray in range(density.shape[0]):
        light = 1.0
        for i in range(density.shape[1]):
            through = np.exp(-float(density[ray, i]) * float(lengths[ray, i]))
            weights[ray, i] = light * (1 - through)
            light *= through
    return weights


@pytest.mark.parametrize("largest", [0.1, 10.0, 1e4])
def test_weights_equal_two_loops(largest: float) -> None:
    rng = np.random.default_rng(0)
    density, lengths = (rng.random((20, 33)) ** 4 * largest).astype(np.float32), rng.random((20, 33)).astype(np.float32)
    lengths[rng.random(lengths.shape) < 0.2] = 0
    weights = volume_weights(jnp.asarray(density), jnp.asarray(lengths))
    np.testing.assert_allclose(weights, reference(density, lengths), atol=2e-6)  # float32 sums of exponents of size 30
    assert weights.min() >= 0
    assert weights.sum(-1).max() <= 1 + 1e-6


def test_one_ray_by_hand() -> None:
    """ln 2 halves the light, ln 4 leaves a quarter: 1/2, then 1/2 * 3/4 = 3/8, nothing, then 1/8 * 1 for an opaque wall."""
    density = jnp.array([[np.log(2.0), np.log(4.0), 7.0, 1e9]])
    weights = volume_weights(density, jnp.array([[1.0, 1.0, 0.0, 1.0]]))
    np.testing.assert_allclose(weights, [[0.5, 0.375, 0.0, 0.125]], atol=1e-6)


def test_faint_light_behind_an_almost_opaque_interval_is_kept() -> None:
    """exp(-20): lost where one minus alpha is taken in float32, as alpha rounds to one there."""
    weights = volume_weights(jnp.array([[20.0, 1e3]]), jnp.ones((1, 2)))
    np.testing.assert_allclose(weights[0, 1], np.exp(-20.0), rtol=1e-5)


@pytest.mark.parametrize("density", [0.0, 1e-30, 1.0, 1e9, 1e30])
@pytest.mark.parametrize("length", [0.0, 1e-20, 1.0, 1e5])
def test_values_and_gradients_are_finite(density: float, length: float) -> None:
    arguments = jnp.full((1, 5), density), jnp.full((1, 5), length)
    weights = volume_weights(*arguments)
    assert np.isfinite(weights).all()
    assert weights.sum() <= 1 + 1e-6
    if length == 0:
        np.testing.assert_array_equal(weights, 0)
    gradient = jax.grad(lambda d, s: volume_weights(d, s) @ jnp.arange(5.0) @ jnp.ones(1), argnums=(0, 1))(*arguments)
    assert all(np.isfinite(g).all() for g in gradient)


def test_gradient_equals_differences_in_float64() -> None:
    rng = np.random.default_rng(1)
    density, lengths, upstream = rng.random((1, 8)) * 3, rng.random((1, 8)), rng.normal(size=8)
    gradient = jax.grad(lambda d: volume_weights(d, jnp.asarray(lengths, jnp.float32))[0] @ jnp.asarray(upstream, jnp.float32))(
        jnp.asarray(density, jnp.float32)
    )
    for i in range(8):
        offset = np.eye(8)[i][None] * 1e-6
        difference = (reference(density + offset, lengths) - reference(density - offset, lengths)) @ upstream / 2e-6
        np.testing.assert_allclose(gradient[0, i], difference[0], atol=2e-6)
