import jax
import jax.numpy as jnp
import numpy as np

from koala3d.reconstruct.scene.contraction import contract, contract_coordinates, contraction_scale, pull_back

CONTRACT = jax.jit(contract)
SCALE = jax.jit(contraction_scale)
PULL_BACK = jax.jit(pull_back)


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
    contracted = CONTRACT(np.float32(points()))
    np.testing.assert_allclose(contracted, reference(points()), atol=3e-7)
    assert np.linalg.norm(contracted, axis=-1).max() <= 2


def test_it_is_continuous_and_smooth_at_the_seam() -> None:
    sides = np.float32([0.48, -0.6, 0.64]) * np.float32([[1 - 1e-6], [1 + 1e-6]])
    sides = np.resize(sides, (60, 3))  # of the points' shape
    np.testing.assert_allclose(*np.asarray(CONTRACT(sides))[:2], atol=3e-6)
    np.testing.assert_allclose(*np.asarray(PULL_BACK(sides, np.tile(np.float32([1, 2, 3]), (60, 1))))[:2], atol=2e-5)
    np.testing.assert_allclose(*np.asarray(SCALE(sides))[:2], atol=5e-6)


def test_scale_is_the_cube_root_of_the_determinant() -> None:
    expected = [np.cbrt(np.linalg.det(jacobian(p))) for p in points()]
    np.testing.assert_allclose(SCALE(np.float32(points())), expected, rtol=2e-4)  # differences of numbers near 2


def test_pull_back_applies_the_transposed_jacobian() -> None:
    gradients = np.random.default_rng(1).normal(size=(60, 3))
    expected = np.stack([jacobian(p).T @ g for p, g in zip(points(), gradients, strict=True)])
    pulled = PULL_BACK(np.float32(points()), np.float32(gradients))
    np.testing.assert_allclose(pulled, expected, atol=2e-6)
    own = jax.jit(lambda p, g: jax.vjp(contract, p)[1](g)[0])(np.float32(points()), np.float32(gradients))
    np.testing.assert_allclose(pulled, own, atol=2e-6)


def test_origin_and_far_away_are_finite() -> None:
    extremes = np.float32([[0.0, 0, 0], [1e-30, 0, 0], [1, 0, 0], [0, 1e15, 0], [1e18, 1e18, 0]])
    functions = (contract, contraction_scale, lambda p: pull_back(p, jnp.ones_like(p)))
    found = jax.jit(lambda p: [jax.value_and_grad(lambda p, f=f: jnp.sum(f(p)))(p) for f in functions])(extremes)
    assert all(np.isfinite(value) and np.isfinite(gradient).all() for value, gradient in found)
    contracted = np.asarray(CONTRACT(np.resize(extremes, (60, 3))))[:5]
    np.testing.assert_allclose(np.linalg.norm(contracted, axis=-1), [0, 0, 1, 2, 2], atol=1e-6)


def test_contracted_coordinates_are_those_of_the_points() -> None:
    """Float32 in both: a root and two products apart, from inside the unit ball to far outside."""
    points = np.float32(np.random.default_rng(5).normal(size=(300, 3)) * np.logspace(-2, 4, 300)[:, None])
    both = jax.jit(lambda p: (jnp.stack(contract_coordinates(*p.T), -1), contract(p)))
    np.testing.assert_allclose(*both(points), rtol=1e-5, atol=1e-6)
