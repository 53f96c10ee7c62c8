import jax
import jax.numpy as jnp
import numpy as np

from koala3d.reconstruct.training import losses


def unit(shape: tuple[int, ...], seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def f32(*arrays: np.ndarray) -> list[jax.Array]:
    return [jnp.asarray(a, jnp.float32) for a in arrays]


def gradients_are_finite(function, *arguments: jax.Array) -> bool:
    total = lambda *a: jnp.sum(function(*a))  # noqa: E731
    return all(np.isfinite(g).all() for g in jax.jit(jax.grad(total, argnums=tuple(range(len(arguments)))))(*arguments))


def test_charbonnier_is_quadratic_then_linear() -> None:
    error = jnp.array([0.0, 1e-5, 1e-3, 0.5, -0.5])
    np.testing.assert_allclose(losses.charbonnier(error, 1e-3), np.hypot(np.asarray(error, np.float64), 1e-3), rtol=1e-6)
    assert gradients_are_finite(lambda e: losses.charbonnier(e, 1e-3), error)


def test_interlevel_counts_only_what_a_proposal_lacks() -> None:
    rng = np.random.default_rng(0)
    target, weights = rng.random((4, 9)) / 9, rng.random((4, 9)) / 9
    expected = [
        sum(max(t - w, 0) ** 2 / (w + 1e-5) for t, w in zip(*row, strict=True)) for row in zip(target, weights, strict=True)
    ]
    np.testing.assert_allclose(losses.interlevel(*f32(target, weights)), expected, rtol=1e-4)
    np.testing.assert_array_equal(losses.interlevel(*f32(weights, weights)), 0)
    assert gradients_are_finite(losses.interlevel, *f32(target, np.zeros_like(target)))
    gradient = jax.grad(lambda t: jnp.sum(losses.interlevel(t, jnp.asarray(weights, jnp.float32))))(
        jnp.asarray(target, jnp.float32)
    )
    np.testing.assert_array_equal(gradient, 0)


def test_distortion_equals_the_double_sum() -> None:
    rng = np.random.default_rng(1)
    edges, weights = np.sort(rng.random((5, 12)) * 3, -1), rng.random((5, 11)) / 11
    middle, length = (edges[:, 1:] + edges[:, :-1]) / 2, np.diff(edges)
    expected = []
    for w, m, l in zip(weights, middle, length, strict=True):  # noqa: E741
        pairs = sum(w[i] * w[j] * abs(m[i] - m[j]) for i in range(11) for j in range(11))
        expected.append(pairs + sum(w**2 * l) / 3)
    np.testing.assert_allclose(losses.distortion(*f32(weights, middle, length)), expected, rtol=1e-5)
    padded = [np.concatenate([a, np.zeros((5, 4))], -1) for a in (weights, middle, length)]
    np.testing.assert_allclose(losses.distortion(*f32(*padded)), expected, rtol=1e-5)
    assert gradients_are_finite(losses.distortion, *f32(weights * 0, middle, length * 0))


def test_hollowness_equals_a_loop_and_only_fills() -> None:
    rng = np.random.default_rng(7)
    weights, density = rng.random((6, 9)) / 9, rng.random((6, 9)) * 50
    weights[:, 6:], density[:, 6:] = 0, 0  # rays of six samples
    expected = [
        sum(w[i] * sum(w[:i]) * max(0.0, 1 - d[i] / d[i - 1]) for i in range(1, 6)) for w, d in zip(weights, density, strict=True)
    ]
    np.testing.assert_allclose(losses.hollowness(*f32(weights, density)), expected, rtol=1e-5)
    gradient = jax.grad(lambda d, w: jnp.sum(losses.hollowness(w, d)))(*f32(density, weights))
    assert (np.asarray(gradient) <= 0).all() and (np.asarray(gradient) < 0).any()  # denser is never dearer
    held = jax.grad(lambda w, d: jnp.sum(losses.hollowness(w, d)))(*f32(weights, density))
    np.testing.assert_array_equal(held, 0)


def test_what_grows_denser_along_the_ray_is_not_hollow_and_nothing_is_neither() -> None:
    weights = jnp.full((1, 5), 0.2)
    np.testing.assert_array_equal(losses.hollowness(weights, jnp.array([[0.0, 0.0, 1.0, 5.0, 1e30]])), 0)
    assert gradients_are_finite(losses.hollowness, weights, jnp.array([[0.0, 1e-38, 0.0, 1e30, 0.0]]))
    assert gradients_are_finite(losses.hollowness, weights, jnp.array([[1e-40, 1e30, 1e-45, 1e30, 1e-34]])), (
        "too small to divide by"
    )
    assert gradients_are_finite(losses.hollowness, jnp.zeros((1, 5)), jnp.zeros((1, 5)))


def test_fog_is_what_is_before_a_surface_and_not_close_to_it() -> None:
    """The surface is at 3, its sample 0.1 long: 2.9 is too near to be fog, and an empty column is nothing."""
    weights = jnp.array([[0.10, 0.02, 0.05, 0.50, 0.30, 0.9]])
    middle, length = jnp.array([[1.0, 2.0, 2.9, 3.0, 3.1, 0.0]]), jnp.array([[0.1, 0.1, 0.1, 0.1, 0.1, 0.0]])
    value, gradient = jax.value_and_grad(lambda w: jnp.sum(losses.fog(w, middle, length, jnp.array([3]))))(weights)
    np.testing.assert_allclose(value, 0.12, rtol=1e-6)
    np.testing.assert_array_equal(gradient, [[1, 1, 0, 0, 0, 0]])


def test_orientation_punishes_normals_that_face_away() -> None:
    normals, viewdirs = unit((40,), 2), unit((40,), 3)
    expected = [max(0.0, float(n @ d)) ** 2 for n, d in zip(normals, viewdirs, strict=True)]
    np.testing.assert_allclose(losses.orientation(*f32(normals.T, viewdirs.T)), expected, atol=1e-6)
    np.testing.assert_array_equal(losses.orientation(-jnp.asarray(viewdirs.T), jnp.asarray(viewdirs.T)), 0)


def test_normal_difference_is_the_squared_distance() -> None:
    first, second = unit((40,), 4), unit((40,), 5)
    np.testing.assert_allclose(losses.normal_difference(*f32(first.T, second.T)), 2 - 2 * np.sum(first * second, -1), atol=2e-6)
    assert gradients_are_finite(losses.normal_difference, *f32(first.T, first.T))
