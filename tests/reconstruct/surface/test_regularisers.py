import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.surface import regularisers


def unit(shape: tuple[int, ...], seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def f32(*arrays: np.ndarray) -> list[jax.Array]:
    return [jnp.asarray(a, jnp.float32) for a in arrays]


def gradients_are_finite(function, *arguments: jax.Array) -> bool:
    total = lambda *a: jnp.sum(function(*a))  # noqa: E731
    return all(np.isfinite(g).all() for g in jax.jit(jax.grad(total, argnums=tuple(range(len(arguments)))))(*arguments))


@pytest.mark.parametrize("form", ["solid", "tangent", "published"])
def test_density_smoothness_equals_a_loop_and_has_no_scale(form: str) -> None:
    density, offsets, normals = np.random.default_rng(6).random((4, 8)) * 20, unit((4, 8), 7), unit((4,), 8)
    radius = np.array([0.01, 0.1, 0.5, 2.0])
    expected = np.zeros(4)
    for ray in range(4):
        for i in range(8):
            along = offsets[ray, i] @ normals[ray]
            through = np.exp(-density[ray, i] * radius[ray])
            unwanted = through if form == "solid" and along < 0 else 1 - through
            expected[ray] += unwanted * abs(1 - along if form == "published" else along) / 8
    ours = lambda d, r: regularisers.density_smoothness(*f32(d, offsets, normals, r), form)  # noqa: E731
    np.testing.assert_allclose(ours(density, radius), expected, rtol=1e-5)
    np.testing.assert_allclose(ours(density / 7, radius * 7), expected, rtol=1e-5)
    edge = f32(np.array([[0.0, 3e6] * 4] * 4), offsets * 0, normals, radius)
    assert gradients_are_finite(lambda *a: regularisers.density_smoothness(*a, form), *edge)


def test_density_in_the_tangent_plane_costs_nothing() -> None:
    normal = jnp.array([[0.0, 0.0, 1.0]])
    angle = np.arange(6)
    around = jnp.asarray(np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)[None], jnp.float32)
    np.testing.assert_array_equal(
        regularisers.density_smoothness(jnp.full((1, 6), 100.0), around, normal, jnp.ones(1), "tangent"), 0
    )


def test_a_solid_below_its_plane_costs_nothing() -> None:
    normal = jnp.array([[0.0, 0.0, 1.0]])
    around = jnp.asarray(unit((1, 64), 3), jnp.float32)
    solid = jnp.where(around[..., 2] < 0, 1e4, 0.0)
    np.testing.assert_allclose(regularisers.density_smoothness(solid, around, normal, jnp.ones(1), "solid"), 0, atol=1e-6)
    hollow = jnp.where(jnp.abs(around[..., 2]) < 0.1, 1e4, 0.0)
    assert float(regularisers.density_smoothness(hollow, around, normal, jnp.ones(1), "solid")[0]) > 0.1


def test_normal_consistency_equals_a_loop() -> None:
    normals, surface = unit((4, 8), 9), unit((4,), 10)
    expected = [np.mean([(1 - abs(n @ s)) / 2 for n in row]) for row, s in zip(normals, surface, strict=True)]
    np.testing.assert_allclose(regularisers.normal_consistency(*f32(normals, surface)), expected, rtol=1e-5)
    parallel = np.repeat(surface[:, None], 8, 1)
    np.testing.assert_allclose(regularisers.normal_consistency(*f32(parallel, surface)), 0, atol=1e-6)
    for edge in (parallel, -parallel, 0 * parallel):
        assert gradients_are_finite(regularisers.normal_consistency, *f32(edge, surface))


def test_lambertian_bias_is_the_magnitude_relative_to_its_maximum() -> None:
    specular = np.random.default_rng(11).random((4, 8, 3))
    expected = [np.mean([np.sum((c / ray.max()) ** 2) for c in ray]) for ray in specular]
    np.testing.assert_allclose(regularisers.lambertian_bias(*f32(specular)), expected, rtol=1e-5)
    np.testing.assert_allclose(regularisers.lambertian_bias(*f32(specular / 50)), expected, rtol=1e-5)
    gradient = jax.grad(lambda s: jnp.sum(regularisers.lambertian_bias(s)))(jnp.asarray(specular, jnp.float32))
    held = 2 * specular / specular.max(axis=(1, 2), keepdims=True) ** 2 / 8  # the maximum is held constant
    np.testing.assert_allclose(gradient, held, rtol=1e-4)
    np.testing.assert_array_equal(regularisers.lambertian_bias(jnp.zeros((2, 8, 3))), 0)
    assert gradients_are_finite(regularisers.lambertian_bias, jnp.zeros((2, 8, 3)))


def metal_or_not_in_float64(diffuse: np.ndarray, specular: np.ndarray) -> list[float]:
    found = []
    for d, c in zip(diffuse, specular, strict=True):
        light = c.mean(-1)
        along = np.clip((light.std() / (d.mean() + light.mean()) - 0.15) / 0.25, 0, 1)
        metal = 3 * along**2 - 2 * along**3
        found.append((metal * d.mean() + (1 - metal) * c.min(0).mean()) / (d.mean() + c.mean()))
    return found


def test_the_bias_for_two_kinds_equals_a_loop_at_any_brightness() -> None:
    random = np.random.default_rng(12)
    diffuse, specular = random.random((40, 3)), random.random((40, 16, 3)) * np.linspace(0.1, 3, 40)[:, None, None]
    expected = metal_or_not_in_float64(diffuse, specular)
    np.testing.assert_allclose(regularisers.metal_or_not(*f32(diffuse, specular)), expected, rtol=1e-4)
    np.testing.assert_allclose(regularisers.metal_or_not(*f32(diffuse / 50, specular / 50)), expected, rtol=1e-4)
    kinds = regularisers.mirrors(*f32(diffuse, specular))
    assert kinds.min() == 0 and kinds.max() > 0.7, "both kinds are among them"


def test_a_mirror_loses_its_diffuse_colour_and_a_matte_surface_what_it_reflects_everywhere() -> None:
    slope = jax.grad(lambda d, c: jnp.sum(regularisers.metal_or_not(d, c)), argnums=(0, 1))
    varying = jnp.linspace(0.0, 1.0, 8)[None, :, None] * jnp.ones((1, 8, 3))
    on_diffuse, on_specular = slope(jnp.full((1, 3), 0.2), varying)
    assert (on_diffuse > 0).all() and not on_specular.any()
    on_diffuse, on_specular = slope(jnp.full((1, 3), 0.2), 0.3 + 0.01 * varying)
    assert not on_diffuse.any() and on_specular.sum() > 0
    assert gradients_are_finite(regularisers.metal_or_not, jnp.zeros((2, 3)), jnp.zeros((2, 8, 3)))
    assert gradients_are_finite(regularisers.metal_or_not, jnp.zeros((2, 3)), jnp.ones((2, 8, 3)))


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
    return regularisers.specular_variation(specular, regularisers.direction_likeness(directions, "angular"), neighbours)


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
    likeness = regularisers.direction_likeness(jnp.asarray(directions, jnp.float32), form)
    colours = jnp.asarray(specular, jnp.float32)
    np.testing.assert_allclose(regularisers.specular_variation(colours, likeness, neighbours), expected, rtol=1e-5)
    ours = jax.grad(lambda s: jnp.sum(regularisers.specular_variation(s, likeness, neighbours)))
    np.testing.assert_allclose(ours(colours), gradient, atol=1e-6)


def test_specular_variation_of_few_directions_and_equal_ones() -> None:
    two = f32(np.array([[[0.0, 0, 0], [1, 0, 0]]]), unit((1, 2), 14))
    np.testing.assert_allclose(variation_by_angle(*two, 3), 1.0)  # one neighbour is all there is: mean |difference|
    np.testing.assert_array_equal(variation_by_angle(jnp.ones((2, 8, 3)), *f32(unit((2, 8), 15)), 3), 0)
    same = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), (1, 8, 3))
    assert gradients_are_finite(lambda s: variation_by_angle(s, same, 3), jnp.zeros((1, 8, 3)))
    np.testing.assert_array_equal(variation_by_angle(jnp.ones((1, 1, 3)), jnp.ones((1, 1, 3)), 3), 0)
