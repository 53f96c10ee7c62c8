import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.surface import regularisers


def unit(shape: tuple[int, ...], seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def f32(*arrays: np.ndarray) -> list[np.ndarray]:
    return [np.float32(a) for a in arrays]


SMOOTHNESS = jax.jit(regularisers.density_smoothness, static_argnums=4)
CONSISTENCY = jax.jit(regularisers.normal_consistency)
BIAS = jax.jit(regularisers.lambertian_bias)
BIAS_FOR_TWO = jax.jit(regularisers.metal_or_not)
VARIATION = jax.jit(regularisers.specular_variation, static_argnums=2)
LIKENESS = jax.jit(regularisers.direction_likeness)


def gradient_of(function):
    """Compiled, of the sum of a function's values to all of its arguments."""
    return jax.jit(lambda *arguments: jax.grad(lambda a: jnp.sum(function(*a)))(arguments))


def all_finite(gradients) -> bool:
    return all(np.isfinite(gradient).all() for gradient in gradients)


@pytest.mark.parametrize("form", ["tangent", "published"])
def test_density_smoothness_equals_a_loop_and_has_no_scale(form: str) -> None:
    density, offsets, normals = np.random.default_rng(6).random((4, 8)) * 20, unit((4, 8), 7), unit((4,), 8)
    radius = np.array([0.01, 0.1, 0.5, 2.0])
    expected = np.zeros(4)
    for ray in range(4):
        for i in range(8):
            along = offsets[ray, i] @ normals[ray]
            through = np.exp(-density[ray, i] * radius[ray])
            expected[ray] += (1 - through) * abs(1 - along if form == "published" else along) / 8
    ours = lambda d, r: SMOOTHNESS(*f32(d, offsets, normals, r), form)  # noqa: E731
    np.testing.assert_allclose(ours(density, radius), expected, rtol=1e-5)
    np.testing.assert_allclose(ours(density / 7, radius * 7), expected, rtol=1e-5)
    edge = f32(np.array([[0.0, 3e6] * 4] * 4), offsets * 0, normals, radius)
    assert all_finite(gradient_of(lambda *a: regularisers.density_smoothness(*a, form))(*edge))


def test_density_in_the_tangent_plane_costs_nothing() -> None:
    normals, angle = np.tile(np.float32([0.0, 0.0, 1.0]), (4, 1)), np.arange(8)
    around = np.tile(np.float32(np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)), (4, 1, 1))
    dense = np.full((4, 8), 100.0, np.float32)
    np.testing.assert_array_equal(SMOOTHNESS(dense, around, normals, np.ones(4, np.float32), "tangent"), 0)


def test_normal_consistency_equals_a_loop() -> None:
    normals, surface = unit((4, 8), 9), unit((4,), 10)
    expected = [np.mean([(1 - abs(n @ s)) / 2 for n in row]) for row, s in zip(normals, surface, strict=True)]
    np.testing.assert_allclose(CONSISTENCY(*f32(normals, surface)), expected, rtol=1e-5)
    parallel = np.repeat(surface[:, None], 8, 1)
    np.testing.assert_allclose(CONSISTENCY(*f32(parallel, surface)), 0, atol=1e-6)
    gradient = gradient_of(regularisers.normal_consistency)
    for edge in (parallel, -parallel, 0 * parallel):
        assert all_finite(gradient(*f32(edge, surface)))


def test_lambertian_bias_is_the_magnitude_relative_to_its_maximum() -> None:
    specular = np.random.default_rng(11).random((4, 8, 3))
    expected = [np.mean([np.sum((c / ray.max()) ** 2) for c in ray]) for ray in specular]
    np.testing.assert_allclose(BIAS(*f32(specular)), expected, rtol=1e-5)
    np.testing.assert_allclose(BIAS(*f32(specular / 50)), expected, rtol=1e-5)
    gradient = gradient_of(regularisers.lambertian_bias)
    held = 2 * specular / specular.max(axis=(1, 2), keepdims=True) ** 2 / 8  # the maximum is held constant
    np.testing.assert_allclose(gradient(*f32(specular))[0], held, rtol=1e-4)
    np.testing.assert_array_equal(BIAS(*f32(0 * specular)), 0)
    assert all_finite(gradient(*f32(0 * specular)))


def metal_or_not_in_float64(diffuse: np.ndarray, specular: np.ndarray) -> list[float]:
    found = []
    for d, c in zip(diffuse, specular, strict=True):
        whole = d + c.mean(0)
        share = min(c[:, i].std() / whole[i] for i in range(3) if whole[i] >= 0.1 * whole.max())
        along = np.clip((share - 0.15) / 0.25, 0, 1)
        metal = 3 * along**2 - 2 * along**3
        found.append((metal * d.mean() + (1 - metal) * c.min(0).mean()) / (d.mean() + c.mean()))
    return found


def test_the_bias_for_two_kinds_equals_a_loop_at_any_brightness() -> None:
    random = np.random.default_rng(12)
    diffuse, specular = random.random((40, 3)), random.random((40, 16, 3)) * np.linspace(0.1, 3, 40)[:, None, None]
    expected = metal_or_not_in_float64(diffuse, specular)
    np.testing.assert_allclose(BIAS_FOR_TWO(*f32(diffuse, specular)), expected, rtol=1e-4)
    np.testing.assert_allclose(BIAS_FOR_TWO(*f32(diffuse / 50, specular / 50)), expected, rtol=1e-4)
    kinds = np.asarray(jax.jit(regularisers.mirrors)(*f32(diffuse, specular)))
    assert kinds.min() == 0 and kinds.max() > 0.7, "both kinds are among them"


def test_a_grey_reflection_on_red_paint_is_no_metal_s() -> None:
    """It varies as much on both: beside 0.5 of red it is small, while gold tints it. A black channel is not asked."""
    light = np.linspace(0.0, 0.2, 8)[None, :, None]
    paint, gold = np.array([[0.5, 0.05, 0.05]]), np.array([1.0, 0.7, 0.3])
    mirrors = jax.jit(regularisers.mirrors)
    np.testing.assert_allclose(mirrors(*f32(paint, light * np.ones(3))), 0)
    np.testing.assert_allclose(mirrors(*f32(0 * paint, light * gold)), 1)
    np.testing.assert_allclose(mirrors(*f32(0 * paint + [0, 0, 0.01], light * [1, 1, 0])), 1)


def test_a_mirror_loses_its_diffuse_colour_and_a_matte_surface_what_it_reflects_everywhere() -> None:
    slope, varying = gradient_of(regularisers.metal_or_not), np.linspace(0.0, 1.0, 8)[None, :, None] * np.ones((1, 8, 3))
    on_diffuse, on_specular = map(np.asarray, slope(*f32(np.full((1, 3), 0.2), varying)))
    assert (on_diffuse > 0).all() and not on_specular.any()
    on_diffuse, on_specular = map(np.asarray, slope(*f32(np.full((1, 3), 0.2), 0.3 + 0.01 * varying)))
    assert not on_diffuse.any() and on_specular.sum() > 0
    for light in (0.0, 1.0):
        assert all_finite(slope(*f32(np.zeros((1, 3)), np.full((1, 8, 3), light))))


def neighbours_by_angle(directions: np.ndarray, count: int) -> np.ndarray:
    """(n, count) nearest others by the angle itself, in float64."""
    angle = np.arccos(np.clip(directions @ directions.T, -1, 1))
    np.fill_diagonal(angle, np.inf)
    return np.argsort(angle, axis=-1)[:, :count]


def variation_by_angle(specular: np.ndarray, directions: np.ndarray, neighbours: int) -> jax.Array:
    return VARIATION(specular, LIKENESS(directions), neighbours)


@functools.partial(jax.jit, static_argnums=2)
def found_and_gradient(specular: jax.Array, likeness: jax.Array, neighbours: int) -> tuple[jax.Array, jax.Array]:
    """The variation, and the gradient of its sum to the colours."""
    found, pull = jax.vjp(lambda s: regularisers.specular_variation(s, likeness, neighbours), specular)
    return found, pull(jnp.ones_like(found))[0]


@pytest.mark.parametrize("neighbours", [1, 3, 5])
def test_specular_variation_runs_over_the_nearest(neighbours: int) -> None:
    specular, directions = np.random.default_rng(12).random((4, 16, 3)), unit((4, 16), 13)
    expected, gradient = np.zeros(4), np.zeros_like(specular)
    for ray in range(4):
        for i, nearest in enumerate(neighbours_by_angle(directions[ray], neighbours)):
            for j in nearest:
                difference = specular[ray, i] - specular[ray, j]
                expected[ray] += np.abs(difference).sum() / (16 * neighbours)
                gradient[ray, i] += np.sign(difference) / (16 * neighbours)  # to the sample, not to its neighbour
    likeness = LIKENESS(np.float32(directions))
    found, pull = found_and_gradient(np.float32(specular), likeness, neighbours)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    np.testing.assert_allclose(pull, gradient, atol=1e-6)


def test_specular_variation_of_few_directions_and_equal_ones() -> None:
    two = f32(np.array([[[0.0, 0, 0], [1, 0, 0]]]), unit((1, 2), 14))
    np.testing.assert_allclose(variation_by_angle(*two, 3), 1.0)  # one neighbour is all there is: mean |difference|
    ones = np.ones((2, 8, 3), np.float32)
    np.testing.assert_array_equal(variation_by_angle(ones, *f32(unit((2, 8), 15)), 3), 0)
    same = LIKENESS(np.tile(np.float32([0.0, 0.0, 1.0]), (2, 8, 1)))
    assert all_finite(found_and_gradient(0 * ones, same, 3))
    np.testing.assert_array_equal(variation_by_angle(ones[:1, :1], ones[:1, :1], 3), 0)
