import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.sampling.samples import RaySamples
from koala3d.reconstruct.surface.first_surface import (
    HALF_WIDTH,
    Surface,
    Surfaces,
    find_surfaces,
    first_surface,
    neighbourhood_radius,
)
from tests import drawn

FIRST = jax.jit(first_surface, static_argnums=2)
RADIUS = jax.jit(neighbourhood_radius)


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
    np.testing.assert_array_equal(FIRST(weights * valid, valid, "median"), by_sorting(weights * valid, valid))


def test_stray_samples_behind_do_not_move_the_surface() -> None:
    clean = [0.0, 0.0, 0.01, 0.7, 0.2, 0.02, 0.0, 0.0]
    stray = [*clean[:6], 0.15, 0.0]
    # medians of 0.005 and of 0.015: one interval on, and not at the stray sample
    np.testing.assert_array_equal(FIRST(np.float32([clean, stray]), np.ones((2, 8), bool), "median"), [2, 3])


def test_rules_differ_where_fog_lies_before_a_surface() -> None:
    """Fog at the start of a ray, more of it than of empty space: it lies above the median weight, and no other rule takes it."""
    fog = np.float32([[0.02, 0.0, 0.0, 0.0, 0.0, 0.30, 0.55, 0.05]] * 2)
    assert [int(FIRST(fog, np.ones((2, 8), bool), rule)[0]) for rule in ("median", "share")] == [0, 5]


@pytest.mark.parametrize("rule", ["median", "share"])
def test_every_rule_takes_the_largest_of_a_ray_without_a_surface_and_no_empty_slot(rule: str) -> None:
    weights = np.float32([[0.1, 0.1, 0.1, *[0.0] * 5], [0.0, 0.9, *[0.0] * 6]])
    valid = np.array([[True, True, True, *[False] * 5], [False, True, True, *[False] * 5]])
    np.testing.assert_array_equal(FIRST(weights, valid, rule), [0, 1])


def test_radius_is_that_of_the_frustum_and_has_the_thin_limit() -> None:
    """The variance across a conical frustum, integrated numerically: area-weighted t^2 r^2 / 4 (a uniform disc has r^2 / 4)."""
    pixel, middle = 0.02, 3.0
    for half in (1.0, 0.3, 0.01):
        t = middle - half + 2 * half * (np.arange(20000) + 0.5) / 20000
        variance = np.sum(t**2 * (pixel * t) ** 2 / 4) / np.sum(t**2)
        ours = RADIUS(*(np.float32([v]) for v in (pixel, middle, half)))
        np.testing.assert_allclose(ours, np.sqrt(2 * np.log(2) * variance), rtol=1e-5)
    limit = RADIUS(*(np.float32([v]) for v in (pixel, middle, 0.0)))
    np.testing.assert_allclose(limit, HALF_WIDTH * pixel * middle / 2, rtol=1e-6)
    np.testing.assert_array_equal(RADIUS(*np.float32([[1], [0], [0]])), 0)


def test_surfaces_are_found_for_opaque_rays_alone_and_carry_no_gradient() -> None:
    weights = np.zeros((6, 8), np.float32)
    weights[[1, 3, 4], [2, 7, 5]] = 0.9, 0.6, 0.3  # of ray 3: the last sample

    @jax.jit
    def found_and_gradient(weights: jax.Array) -> tuple[Surface, jax.Array]:
        samples = RaySamples.from_edges(jnp.broadcast_to(jnp.linspace(1, 5, 9), (6, 9)))
        find = lambda weights: find_surfaces(weights, samples, jnp.full(6, 0.01), 4)  # noqa: E731
        return find(weights), jax.grad(lambda weights: jnp.sum(find(weights).weight))(weights)

    found, gradient = jax.tree.map(np.asarray, found_and_gradient(weights))
    np.testing.assert_array_equal(found.ray[:2], [1, 3])
    np.testing.assert_allclose(found.t[:2], [2.25, 4.75])
    np.testing.assert_allclose(found.weight, [0.9, 0.6, 0, 0])
    np.testing.assert_allclose(found.radius[:2], RADIUS(*np.float32([[0.01, 0.01], [2.25, 4.75], [0.25, 0.25]])))
    assert np.isfinite(found.radius).all()
    np.testing.assert_array_equal(gradient, 0)


def test_solid_surfaces_take_the_place_of_the_first_ray_by_ray() -> None:
    ones = np.ones(500, np.float32)
    first = Surface(drawn.array(np.arange(500), np.int32), drawn.array(2 * ones), drawn.array(ones), drawn.array(0.1 * ones))
    both = Surfaces(first, Surface(first.ray, drawn.array(3 * ones), first.weight, first.radius))
    choose = jax.jit(lambda both, share, at_object: both.settled(share, at_object))
    for share in (0.0, 0.3, 1.0):
        chosen = choose(both, np.float32(share), np.ones(500, bool))
        taken = np.asarray(chosen.first.t) == 3
        assert [taken[part].mean() for part in (slice(250), slice(250, 500))] == pytest.approx([share] * 2, abs=0.02)
        np.testing.assert_array_equal(chosen.solid.t, 3)
    at_object = np.arange(500) < 200
    np.testing.assert_array_equal(np.asarray(choose(both, np.float32(1), at_object).first.t) == 3, at_object)
