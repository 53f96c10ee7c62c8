import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.numerics.volume import OPAQUE, SURFACE, optical_depth, volume_weights


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
    weights = volume_weights(jnp.asarray(density * lengths))
    np.testing.assert_allclose(weights, reference(density, lengths), atol=2e-6)  # float32 sums of exponents of size 30
    assert weights.min() >= 0
    assert weights.sum(-1).max() <= 1 + 1e-6


def test_one_ray_by_hand() -> None:
    """ln 2 halves the light, ln 4 leaves a quarter: 1/2, then 1/2 * 3/4 = 3/8, nothing, then 1/8 * 1 for an opaque wall."""
    density = jnp.array([[np.log(2.0), np.log(4.0), 7.0, 1e9]])
    weights = volume_weights(density * jnp.array([[1.0, 1.0, 0.0, 1.0]]))
    np.testing.assert_allclose(weights, [[0.5, 0.375, 0.0, 0.125]], atol=1e-6)


def test_faint_light_behind_an_almost_opaque_interval_is_kept() -> None:
    """exp(-20): lost where one minus alpha is taken in float32, as alpha rounds to one there."""
    weights = volume_weights(jnp.array([[20.0, 1e3]]))
    np.testing.assert_allclose(weights[0, 1], np.exp(-20.0), rtol=1e-5)


@pytest.mark.parametrize("density", [0.0, 1e-30, 1.0, 1e9, 1e30])
@pytest.mark.parametrize("length", [0.0, 1e-20, 1.0, 1e5])
def test_values_and_gradients_are_finite(density: float, length: float) -> None:
    arguments = jnp.full((1, 5), density), jnp.full((1, 5), length)
    weights = volume_weights(arguments[0] * arguments[1])
    assert np.isfinite(weights).all()
    assert weights.sum() <= 1 + 1e-6
    if length == 0:
        np.testing.assert_array_equal(weights, 0)
    gradient = jax.grad(lambda d, s: volume_weights(d * s) @ jnp.arange(5.0) @ jnp.ones(1), argnums=(0, 1))(*arguments)
    assert all(np.isfinite(g).all() for g in gradient)


def test_gradient_equals_differences_in_float64() -> None:
    rng = np.random.default_rng(1)
    density, lengths, upstream = rng.random((1, 8)) * 3, rng.random((1, 8)), rng.normal(size=8)
    gradient = jax.grad(lambda d: volume_weights(d * jnp.asarray(lengths, jnp.float32))[0] @ jnp.asarray(upstream, jnp.float32))(
        jnp.asarray(density, jnp.float32)
    )
    for i in range(8):
        offset = np.eye(8)[i][None] * 1e-6
        difference = (reference(density + offset, lengths) - reference(density - offset, lengths)) @ upstream / 2e-6
        np.testing.assert_allclose(gradient[0, i], difference[0], atol=2e-6)


def rises(density: jax.Array) -> jax.Array:
    """Optical depths of samples on rays through a solid."""
    before = jnp.pad(density[..., :-1], [(0, 0)] * (density.ndim - 1) + [(1, 0)])
    return optical_depth(density, before, jnp.ones_like(density), solid=True)


LEVEL = np.log(2) / SURFACE
"""Density of a surface."""


def test_a_solid_absorbs_where_the_density_rises() -> None:
    """What is left is that of the largest density, however many samples there are in front of it; a second wall counts."""
    for steps in (1, 2, 50):
        density = jnp.asarray(np.linspace(0, LEVEL, steps + 1)[None, 1:], jnp.float32)
        np.testing.assert_allclose(1 - volume_weights(rises(density)).sum(), 0.5, rtol=3e-5)  # 50 differences of float32
    depth = rises(jnp.asarray([[LEVEL, LEVEL, 0.5 * LEVEL, 1.5 * LEVEL, 1e30]], jnp.float32))
    np.testing.assert_allclose(volume_weights(depth), [[0.5, 0, 0, 0.25, 0.25]], atol=1e-6)
    assert depth[0, -1] == OPAQUE


def test_a_ray_that_touches_a_ball_loses_as_much_as_one_that_meets_it() -> None:
    """In a fog it loses more: the softer its border, the deeper it looks when met head on."""
    radius, softness, steps = 0.8, 0.01, 40_001
    way = np.linspace(-1, 0, steps)
    touching = LEVEL * np.exp((radius - np.hypot(way, radius)) / softness)
    on_it = LEVEL * np.exp((radius + way) / softness)[way < -radius]
    left = [np.exp(-float(rises(jnp.asarray(density, jnp.float32)).sum())) for density in (touching, on_it)]
    np.testing.assert_allclose(left, 0.5, atol=0.002)  # the last step in front of the surface: 1/400 of the softness
    left = [np.exp(-density.sum() / (steps - 1)) for density in (touching, on_it)]
    assert left[0] < 0.05 and left[1] > 0.6  # on both halves of the way the former would have lost twice as much


def test_nothing_is_lost_at_samples_without_length() -> None:
    density, before, lengths = jnp.asarray([3.0, 5.0, 5.0]), jnp.asarray([1.0, 6.0, 0.0]), jnp.asarray([0.5, 0.5, 0.0])
    np.testing.assert_allclose(optical_depth(density, before, lengths, solid=True), [2 * SURFACE, 0, 0], rtol=1e-6)
    np.testing.assert_allclose(optical_depth(density, before, lengths, solid=False), [1.5, 2.5, 0], rtol=1e-6)
