import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.surface import losses


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


def test_orientation_punishes_normals_that_face_away() -> None:
    normals, viewdirs = unit((40,), 2), unit((40,), 3)
    expected = [max(0.0, float(n @ d)) ** 2 for n, d in zip(normals, viewdirs, strict=True)]
    np.testing.assert_allclose(losses.orientation(*f32(normals.T, viewdirs.T)), expected, atol=1e-6)
    np.testing.assert_array_equal(losses.orientation(-jnp.asarray(viewdirs.T), jnp.asarray(viewdirs.T)), 0)


def test_normal_difference_is_the_squared_distance() -> None:
    first, second = unit((40,), 4), unit((40,), 5)
    np.testing.assert_allclose(losses.normal_difference(*f32(first.T, second.T)), 2 - 2 * np.sum(first * second, -1), atol=2e-6)
    assert gradients_are_finite(losses.normal_difference, *f32(first.T, first.T))


@pytest.mark.parametrize("form", ["tangent", "published"])
def test_density_smoothness_equals_a_loop_and_has_no_scale(form: str) -> None:
    density, offsets, normals = np.random.default_rng(6).random((4, 8)) * 20, unit((4, 8), 7), unit((4,), 8)
    radius = np.array([0.01, 0.1, 0.5, 2.0])
    expected = np.zeros(4)
    for ray in range(4):
        for i in range(8):
            along = offsets[ray, i] @ normals[ray]
            expected[ray] += (1 - np.exp(-density[ray, i] * radius[ray])) * abs(along if form == "tangent" else 1 - along) / 8
    ours = lambda d, r: losses.density_smoothness(*f32(d, offsets, normals, r), form)  # noqa: E731
    np.testing.assert_allclose(ours(density, radius), expected, rtol=1e-5)
    np.testing.assert_allclose(ours(density / 7, radius * 7), expected, rtol=1e-5)
    edge = f32(np.array([[0.0, 3e6] * 4] * 4), offsets * 0, normals, radius)
    assert gradients_are_finite(lambda *a: losses.density_smoothness(*a, form), *edge)


def test_density_in_the_tangent_plane_costs_nothing() -> None:
    normal = jnp.array([[0.0, 0.0, 1.0]])
    angle = np.arange(6)
    around = jnp.asarray(np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)[None], jnp.float32)
    np.testing.assert_array_equal(losses.density_smoothness(jnp.full((1, 6), 100.0), around, normal, jnp.ones(1), "tangent"), 0)


def test_normal_consistency_equals_a_loop() -> None:
    normals, surface = unit((4, 8), 9), unit((4,), 10)
    expected = [np.mean([(1 - abs(n @ s)) / 2 for n in row]) for row, s in zip(normals, surface, strict=True)]
    np.testing.assert_allclose(losses.normal_consistency(*f32(normals, surface)), expected, rtol=1e-5)
    parallel = np.repeat(surface[:, None], 8, 1)
    np.testing.assert_allclose(losses.normal_consistency(*f32(parallel, surface)), 0, atol=1e-6)
    for edge in (parallel, -parallel, 0 * parallel):
        assert gradients_are_finite(losses.normal_consistency, *f32(edge, surface))


def test_lambertian_bias_is_the_magnitude_relative_to_its_maximum() -> None:
    specular = np.random.default_rng(11).random((4, 8, 3))
    expected = [np.mean([np.sum((c / ray.max()) ** 2) for c in ray]) for ray in specular]
    np.testing.assert_allclose(losses.lambertian_bias(*f32(specular)), expected, rtol=1e-5)
    np.testing.assert_allclose(losses.lambertian_bias(*f32(specular / 50)), expected, rtol=1e-5)
    gradient = jax.grad(lambda s: jnp.sum(losses.lambertian_bias(s)))(jnp.asarray(specular, jnp.float32))
    held = 2 * specular / specular.max(axis=(1, 2), keepdims=True) ** 2 / 8  # the maximum is held constant
    np.testing.assert_allclose(gradient, held, rtol=1e-4)
    np.testing.assert_array_equal(losses.lambertian_bias(jnp.zeros((2, 8, 3))), 0)
    assert gradients_are_finite(losses.lambertian_bias, jnp.zeros((2, 8, 3)))


def neighbours_by_angle(directions: np.ndarray, count: int) -> np.ndarray:
    """(n, count) nearest others by the angle itself, in float64."""
    angle = np.arccos(np.clip(directions @ directions.T, -1, 1))
    np.fill_diagonal(angle, np.inf)
    return np.argsort(angle, axis=-1)[:, :count]


def neighbours_as_published(directions: np.ndarray, count: int) -> np.ndarray:
    """The same by the cosine between (polar angle, azimuth, length), in float64."""
    x, y, z = directions.T
    triples = np.stack([np.arccos(z), np.arctan2(y, x), np.ones_like(z)], -1)
    cosine = triples @ triples.T / np.outer(*[np.linalg.norm(triples, axis=-1)] * 2)
    np.fill_diagonal(cosine, -np.inf)
    return np.argsort(-cosine, axis=-1)[:, :count]


NEIGHBOURS = {"angular": neighbours_by_angle, "published": neighbours_as_published}


def variation_by_angle(specular: jnp.ndarray, directions: jnp.ndarray, neighbours: int) -> jnp.ndarray:
    return losses.specular_variation(specular, losses.direction_likeness(directions, "angular"), neighbours)


@pytest.mark.parametrize("neighbours", [1, 3, 5])
@pytest.mark.parametrize("form", NEIGHBOURS)
def test_specular_variation_runs_over_the_nearest(form: str, neighbours: int) -> None:
    specular, directions = np.random.default_rng(12).random((4, 16, 3)), unit((4, 16), 13)
    expected, gradient = np.zeros(4), np.zeros_like(specular)
    for ray in range(4):
        for i, nearest in enumerate(NEIGHBOURS[form](directions[ray], neighbours)):
            for j in nearest:
                difference = specular[ray, i] - specular[ray, j]
                expected[ray] += np.abs(difference).sum() / (16 * neighbours)
                gradient[ray, i] += np.sign(difference) / (16 * neighbours)  # to the sample, not to its neighbour
    likeness = losses.direction_likeness(jnp.asarray(directions, jnp.float32), form)
    colours = jnp.asarray(specular, jnp.float32)
    np.testing.assert_allclose(losses.specular_variation(colours, likeness, neighbours), expected, rtol=1e-5)
    ours = jax.grad(lambda s: jnp.sum(losses.specular_variation(s, likeness, neighbours)))
    np.testing.assert_allclose(ours(colours), gradient, atol=1e-6)


def test_specular_variation_of_few_directions_and_equal_ones() -> None:
    two = f32(np.array([[[0.0, 0, 0], [1, 0, 0]]]), unit((1, 2), 14))
    np.testing.assert_allclose(variation_by_angle(*two, 3), 1.0)  # one neighbour is all there is: mean |difference|
    np.testing.assert_array_equal(variation_by_angle(jnp.ones((2, 8, 3)), *f32(unit((2, 8), 15)), 3), 0)
    same = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), (1, 8, 3))
    assert gradients_are_finite(lambda s: variation_by_angle(s, same, 3), jnp.zeros((1, 8, 3)))
    np.testing.assert_array_equal(variation_by_angle(jnp.ones((1, 1, 3)), jnp.ones((1, 1, 3)), 3), 0)
