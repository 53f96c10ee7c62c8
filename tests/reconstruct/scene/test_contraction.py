import jax
import jax.numpy as jnp
import numpy as np

from reconstruct.scene.contraction import contract, contract_coordinates, contraction_scale, pull_back


def reference(points: np.ndarray) -> np.ndarray:
    """Mip-NeRF 360, equation 10, in float64."""
    radius = np.linalg.norm(points, axis=-1, keepdims=True)
    return np.where(radius <= 1, points, (2 - 1 / np.maximum(radius, 1)) * points / np.maximum(radius, 1))


def jacobian(point: np.ndarray) -> np.ndarray:
    """(3, 3) by central differences of the float64 reference."""
    step = 1e-6 * max(1, np.linalg.norm(point))
    return np.stack([(reference(point + step * e) - reference(point - step * e)) / (2 * step) for e in np.eye(3)], -1)


def points() -> np.ndarray:
    """Inside, outside and far away, none within 1e-3 of the seam."""
    directions = np.random.default_rng(0).normal(size=(60, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return directions * np.geomspace(0.05, 1e3, 60)[:, None]


def test_it_equals_the_formula_and_stays_in_the_ball() -> None:
    contracted = contract(jnp.asarray(points(), jnp.float32))
    np.testing.assert_allclose(contracted, reference(points()), atol=3e-7)
    assert np.linalg.norm(contracted, axis=-1).max() <= 2


def test_it_is_continuous_and_smooth_at_the_seam() -> None:
    direction = jnp.array([0.48, -0.6, 0.64])
    inside, outside = (contract(direction * r) for r in (1 - 1e-6, 1 + 1e-6))
    np.testing.assert_allclose(inside, outside, atol=3e-6)
    g = jnp.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(pull_back(direction * (1 - 1e-6), g), pull_back(direction * (1 + 1e-6), g), atol=2e-5)
    np.testing.assert_allclose(*(contraction_scale(direction * r) for r in (1 - 1e-6, 1 + 1e-6)), atol=5e-6)


def test_scale_is_the_cube_root_of_the_determinant() -> None:
    expected = [np.cbrt(np.linalg.det(jacobian(p))) for p in points()]
    np.testing.assert_allclose(
        contraction_scale(jnp.asarray(points(), jnp.float32)), expected, rtol=2e-4
    )  # differences of numbers near 2


def test_pull_back_applies_the_transposed_jacobian() -> None:
    gradients = np.random.default_rng(1).normal(size=(60, 3))
    expected = np.stack([jacobian(p).T @ g for p, g in zip(points(), gradients, strict=True)])
    pulled = pull_back(jnp.asarray(points(), jnp.float32), jnp.asarray(gradients, jnp.float32))
    np.testing.assert_allclose(pulled, expected, atol=2e-6)
    own = jax.vjp(contract, jnp.asarray(points(), jnp.float32))[1](jnp.asarray(gradients, jnp.float32))[0]
    np.testing.assert_allclose(pulled, own, atol=2e-6)


def test_origin_and_far_away_are_finite() -> None:
    extremes = jnp.array([[0.0, 0, 0], [1e-30, 0, 0], [1, 0, 0], [0, 1e15, 0], [1e18, 1e18, 0]])
    for function in (contract, contraction_scale, lambda p: pull_back(p, jnp.ones_like(p))):
        value, gradient = jax.jit(jax.value_and_grad(lambda p, f=function: jnp.sum(f(p))))(extremes)
        assert np.isfinite(value)
        assert np.isfinite(gradient).all()
    np.testing.assert_allclose(np.linalg.norm(contract(extremes), axis=-1), [0, 0, 1, 2, 2], atol=1e-6)


def test_contracted_coordinates_are_those_of_the_points() -> None:
    """Float32 in both: a root and two products apart, from inside the unit ball to far outside."""
    points = np.random.default_rng(5).normal(size=(300, 3)) * np.logspace(-2, 4, 300)[:, None]
    points = jnp.asarray(points, jnp.float32)
    np.testing.assert_allclose(jnp.stack(contract_coordinates(*points.T), -1), contract(points), rtol=1e-5, atol=1e-6)
