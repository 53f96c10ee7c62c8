import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.sampling.samples import RaySamples
from reconstruct.surface.first_surface import HALF_WIDTH, Surface, Surfaces, find_surfaces, first_surface, neighbourhood_radius

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


def test_rules_differ_where_fog_lies_before_a_surface() -> None:
    """Fog at the start of a ray, more of it than of empty space: it lies above the median weight, and no other rule takes it."""
    fog = jnp.array([[0.02, 0.0, 0.0, 0.0, 0.0, 0.30, 0.55, 0.05]])
    everything = jnp.ones((1, 8), bool)
    assert [int(first_surface(fog, everything, rule)[0]) for rule in ("median", "share", "half")] == [0, 5, 6]


@pytest.mark.parametrize("rule", ["median", "share", "half"])
def test_every_rule_takes_the_largest_of_a_ray_without_a_surface_and_no_empty_slot(rule: str) -> None:
    weights = jnp.array([[0.1, 0.1, 0.1, 0.0], [0.0, 0.9, 0.0, 0.0]])
    valid = jnp.array([[True, True, True, False], [False, True, True, False]])
    np.testing.assert_array_equal(first_surface(weights, valid, rule), [0, 1])


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


def test_solid_surfaces_take_the_place_of_the_first_once_settled() -> None:
    first = Surface(jnp.array([0, 1], jnp.int32), jnp.full(2, 2.0), jnp.ones(2), jnp.full(2, 0.1))
    both = Surfaces(first, Surface(first.ray, first.t + 1, first.weight, first.radius))
    for settled, depth in ((False, 2.0), (True, 3.0)):
        chosen = both.solid_where(jnp.asarray(settled)).of_rays(1)
        assert (chosen.first.t.tolist(), chosen.solid.t.tolist()) == ([depth], [3.0])
