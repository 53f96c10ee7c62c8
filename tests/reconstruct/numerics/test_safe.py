import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.numerics.safe import MAX_EXPONENT, normalise, safe_exp, safe_norm, srgb_from_linear

SIZES = [0.0, 1e-45, 1e-38, 1e-30, 1e-20, 1e-12, 1e-6, 1.0, 1e6, 1e18, 1e30]


@jax.jit
def all_gradients(vectors: jax.Array) -> dict[str, jax.Array]:
    functions = {
        "norm": safe_norm,
        "normalise": lambda x: normalise(x) @ jnp.array([1.0, 2, 3]),
        "srgb": lambda x: srgb_from_linear(jnp.abs(x)),
    }
    return {name: jax.grad(lambda v, f=f: jnp.sum(f(v)))(vectors) for name, f in functions.items()}


def test_exp_saturates_and_can_still_fall() -> None:
    x = jnp.array([-80.0, -1.0, 0.0, 3.0, 14.9, 20.0, 1e30])
    np.testing.assert_allclose(
        safe_exp(x), np.exp(np.minimum(np.asarray(x, np.float64), MAX_EXPONENT)), rtol=2e-6
    )  # float32, argument up to 15
    gradient = jax.grad(lambda x: jnp.sum(safe_exp(x)))(x)
    np.testing.assert_array_equal(gradient, safe_exp(x))
    assert gradient[-1] > 0


@pytest.mark.parametrize("size", SIZES)
def test_gradients_are_finite_at_every_size(size: float) -> None:
    vectors = jnp.array([[1.0, 0, 0], [0.6, -0.8, 0], [1.0, 1, 1], [0.0, 1e-8, 1]]) * jnp.float32(size)
    for name, gradient in all_gradients(vectors).items():
        assert np.isfinite(gradient).all(), name


@pytest.mark.parametrize("size", SIZES)
def test_normalised_vectors_have_unit_length_or_shrink_to_zero(size: float) -> None:
    directions = np.random.default_rng(0).normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    length = np.linalg.norm(
        np.asarray(jax.jit(normalise)(jnp.asarray(directions, jnp.float32) * jnp.float32(size)), np.float64), axis=-1
    )
    assert (length <= 1 + 1e-6).all()
    if size > 2e-12:
        np.testing.assert_allclose(length, 1, atol=1e-6)
    if size == 0:
        np.testing.assert_array_equal(length, 0)


def test_normalised_length_never_exceeds_one_at_the_floor() -> None:
    sizes = jnp.logspace(-13, -11, 200)
    length = jnp.linalg.norm(normalise(sizes[:, None] * jnp.ones(3)) * 1.0, axis=-1)
    assert length.max() <= 1 + 1e-6
    assert (jnp.diff(length) >= -1e-6).all()


def test_what_has_no_direction_has_no_gradient_however_often_it_is_normalised() -> None:
    twice = jax.grad(lambda x: jnp.sum(normalise(normalise(x))))
    for size in (0.0, 1e-20, 1e-13):
        np.testing.assert_array_equal(twice(jnp.full(3, size)), 0)
    assert np.isfinite(twice(jnp.array([1e-11, 0, 2e-11]))).all()


def test_normalisation_has_the_gradient_of_x_over_its_length() -> None:
    x, weights = np.array([0.3, -1.2, 0.7]), np.array([1.0, -2.0, 0.5])
    length = np.linalg.norm(x)
    expected = (weights - (weights @ x) * x / length**2) / length
    np.testing.assert_allclose(
        jax.grad(lambda x: normalise(x) @ jnp.asarray(weights, jnp.float32))(jnp.asarray(x, jnp.float32)), expected, atol=1e-6
    )


def test_norm_along_an_axis() -> None:
    x = np.random.default_rng(1).normal(size=(3, 5))
    np.testing.assert_allclose(safe_norm(jnp.asarray(x, jnp.float32), axis=0), np.linalg.norm(x, axis=0), rtol=1e-6)
    np.testing.assert_array_equal(jax.grad(safe_norm)(jnp.zeros(3)), 0)


def test_srgb_follows_the_standard_and_is_continuous_at_its_seam() -> None:
    linear = np.array([0, 1e-4, 0.0031308, 0.18, 0.5, 1.0, 2.0])
    expected = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(srgb_from_linear(jnp.asarray(linear, jnp.float32)), expected, atol=1e-6)
    np.testing.assert_allclose(srgb_from_linear(jnp.array([0.2140])), [0.5], atol=1e-4)  # the well-known middle grey
    below, above = srgb_from_linear(jnp.array([0.00313, 0.003132]))
    assert 0 < above - below < 5e-5
