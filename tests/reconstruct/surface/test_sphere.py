import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import kstest

from reconstruct.sampling.samples import RaySamples
from reconstruct.surface.sphere import (
    HALF_WIDTH,
    ball_samples,
    find_surfaces,
    first_surface,
    neighbourhood_radius,
    random_rotations,
    shell_radii,
    sphere_directions,
)

FIRST = jax.jit(first_surface)


def by_sorting(weights: np.ndarray, valid: np.ndarray) -> list[int]:
    """The definition: the first entry above the median of the ray's entries; the largest where there is none."""
    result = []
    for w, v in zip(weights, valid, strict=True):
        above = np.flatnonzero(v & (w > np.median(w[v]))) if v.any() else []
        result.append(int(above[0]) if len(above) else int(np.argmax(np.where(v, w, -1))))
    return result


@pytest.mark.parametrize("slots", [1, 2, 5, 8, 33])
def test_first_surface_is_the_first_above_the_median(slots: int) -> None:
    rng = np.random.default_rng(slots)
    weights = (rng.random((200, slots)) ** 6).astype(np.float32)
    weights[50:100] = np.round(weights[50:100], 1)  # ties, and zeros for most
    weights[100:110] = 0.25
    weights[110:115] = 0
    valid = np.arange(slots) < rng.integers(1, slots + 1, 200)[:, None]
    np.testing.assert_array_equal(FIRST(jnp.asarray(weights * valid), jnp.asarray(valid)), by_sorting(weights * valid, valid))


def test_stray_samples_behind_do_not_move_the_surface() -> None:
    clean = jnp.array([[0.0, 0.0, 0.01, 0.7, 0.2, 0.02, 0.0, 0.0]])
    stray = clean.at[0, 6].set(0.15)
    everything = jnp.ones((1, 8), bool)
    np.testing.assert_array_equal(FIRST(clean, everything), [2])  # median 0.005
    np.testing.assert_array_equal(FIRST(stray, everything), [3])  # median 0.015: one interval on, and not at the stray sample


def test_radius_is_that_of_the_frustum_and_has_the_thin_limit() -> None:
    """The variance across a conical frustum, integrated numerically: area-weighted t^2 r^2 / 4 (a uniform disc has r^2 / 4)."""
    pixel, middle = 0.02, 3.0
    for half in (1.0, 0.3, 0.01):
        t = middle - half + 2 * half * (np.arange(20000) + 0.5) / 20000
        variance = np.sum(t**2 * (pixel * t) ** 2 / 4) / np.sum(t**2)
        ours = neighbourhood_radius(*(jnp.full(1, v) for v in (pixel, middle, half)))
        np.testing.assert_allclose(ours, np.sqrt(2 * np.log(2) * variance), rtol=1e-5)
    limit = neighbourhood_radius(*(jnp.full(1, v) for v in (pixel, middle, 0.0)))
    np.testing.assert_allclose(limit, HALF_WIDTH * pixel * middle / 2, rtol=1e-6)
    np.testing.assert_array_equal(neighbourhood_radius(jnp.ones(1), jnp.zeros(1), jnp.zeros(1)), 0)


def test_surfaces_are_found_for_opaque_rays_alone_and_carry_no_gradient() -> None:
    edges = jnp.broadcast_to(jnp.linspace(1, 5, 9), (6, 9))
    samples = RaySamples.from_edges(edges)
    weights = jnp.zeros((6, 8)).at[1, 2].set(0.9).at[3, 7].set(0.6).at[4, 5].set(0.3)  # ray 3: the last sample
    found = jax.jit(find_surfaces, static_argnums=3)(weights, samples, jnp.full(6, 0.01), 4)
    np.testing.assert_array_equal(found.ray[:2], [1, 3])
    np.testing.assert_allclose(found.t[:2], [2.25, 4.75])
    np.testing.assert_allclose(found.weight, [0.9, 0.6, 0, 0])
    np.testing.assert_allclose(
        found.radius[:2], neighbourhood_radius(jnp.full(2, 0.01), jnp.array([2.25, 4.75]), jnp.full(2, 0.25))
    )
    assert np.isfinite(found.radius).all()
    gradient = jax.grad(lambda w: jnp.sum(find_surfaces(w, samples, jnp.full(6, 0.01), 4).weight))(weights)
    np.testing.assert_array_equal(gradient, 0)


@pytest.mark.parametrize("count", [4, 32, 1000])
def test_sphere_directions_are_uniform(count: int) -> None:
    directions = sphere_directions(count)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-12)
    assert np.abs(directions[:, 0]).max() <= 1
    np.testing.assert_allclose(directions[:, 0], 1 - (2 * np.arange(1, count + 1) - 1) / count, atol=1e-12)
    if count >= 32:  # low-discrepancy: moments are those of the sphere far more closely than 1/sqrt(count)
        np.testing.assert_allclose(directions.mean(0), 0, atol=1.5 / count)
        np.testing.assert_allclose(directions.T @ directions / count, np.eye(3) / 3, atol=2 / count)
        cosine = directions @ directions.T - 2 * np.eye(count)
        spacing = np.arccos(cosine.max(-1))
        even = np.sqrt(4 * np.pi / count)  # side of a cell of equal area
        assert spacing.min() > 0.6 * even, "no clusters"
        assert spacing.max() < 1.2 * even, "no holes"


@pytest.mark.parametrize("kappa", [0.5, 5.0, 50.0, 1e4])
def test_concentrated_directions_have_the_lobe_s_moments(kappa: float) -> None:
    """E[w] = coth kappa - 1 / kappa and E[w^2] = 1 - 2 E[w] / kappa (Mardia and Jupp 2000, section 9.3.2)."""
    directions = sphere_directions(4000, kappa)
    first = 1 / np.tanh(kappa) - 1 / kappa
    w = directions[:, 0]
    np.testing.assert_allclose(1 - w.mean(), 1 - first, rtol=1e-3)  # the midpoint rule in probability at 4000 nodes
    np.testing.assert_allclose(1 - np.mean(w**2), 2 * first / kappa, rtol=1e-3)
    assert np.abs(w).max() <= 1
    np.testing.assert_allclose(directions[:, 1:].mean(0), 0, atol=1e-3)


def test_no_concentration_is_the_limit_of_little() -> None:
    uniform = sphere_directions(32)
    for kappa in (1e-12, 1e-7, 1e-6, 1e-5, 1e-4):
        np.testing.assert_allclose(sphere_directions(32, kappa)[:, 0], uniform[:, 0], atol=max(kappa, 1e-9))
        np.testing.assert_allclose(sphere_directions(32, kappa), uniform, atol=max(5 * kappa, 1e-8))


def test_shells_are_the_supplement_s() -> None:
    radii = shell_radii(32)
    np.testing.assert_allclose(radii, [(1 + i % 5) / 5 for i in range(1, 33)])
    np.testing.assert_allclose(np.unique(radii), np.arange(1, 6) / 5)
    assert shell_radii(1).shape == (1,)


def test_random_rotations_are_uniform() -> None:
    """Statistics of 20 000 rotations against Haar's measure, at five standard errors.

    Entries have mean 0 and variance 1/3; the trace is 1 + 2 cos of an angle whose density is (1 - cos) / pi; a second
    rotation from the left changes nothing.
    """
    count = 20_000
    rotations = np.asarray(random_rotations(jax.random.key(0), count), np.float64)
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.broadcast_to(np.eye(3), rotations.shape), atol=2e-6)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=2e-6)
    assert np.abs(rotations.mean(0)).max() < 5 * np.sqrt(1 / 3 / count)
    spread = 5 * np.sqrt((1 / 5 - 1 / 9) / count)  # entries are uniform on [-1, 1]: E[x^4] = 1/5
    np.testing.assert_allclose((rotations**2).mean(0), 1 / 3, atol=spread)
    for column in rotations.reshape(count, 9).T:
        assert kstest(column, "uniform", args=(-1, 2)).pvalue > 1e-4
    angle = np.arccos(np.clip((np.trace(rotations, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert kstest(angle, lambda a: (a - np.sin(a)) / np.pi).pvalue > 1e-4
    turn = rotations[0] @ rotations
    angle = np.arccos(np.clip((np.trace(turn[1:], axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert kstest(angle, lambda a: (a - np.sin(a)) / np.pi).pvalue > 1e-4


@pytest.mark.parametrize("sampling", ["lattice", "fibonacci", "random"])
def test_ball_samples_are_unit_directions_and_radii(sampling: str) -> None:
    directions, radii = ball_samples(jax.random.key(0), 400, 32, 0.0, sampling)
    assert directions.shape == (400, 32, 3) and radii.shape == (32,)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-5)
    np.testing.assert_allclose(radii, 1 if sampling == "fibonacci" else shell_radii(32), atol=1e-6)
    # uniform over rays and samples: means of 12 800 (dependent within a ray: at most 400 free) directions
    assert np.abs(np.asarray(directions).mean((0, 1))).max() < 5 / np.sqrt(3 * 400)
    nearest = np.sort(np.asarray(directions @ directions.transpose(0, 2, 1)), -1)[..., -2]
    closest = np.degrees(np.arccos(np.clip(nearest.max(-1), -1, 1))).min()
    assert (closest < 5) == (sampling == "random"), "a lattice keeps its directions apart, chance does not"
