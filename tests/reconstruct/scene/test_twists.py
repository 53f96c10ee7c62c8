import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from reconstruct.scene.rays import Rays
from reconstruct.scene.twists import followed, gauge, moved, without_gauge

VIEWS, RAYS = 7, 60
SIGMA = jnp.array([5e-3] * 3 + [9e-4] * 3)


def some_rays(seed: int = 0) -> Rays:
    """Rays of a few views, a unit or so from the origin."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(VIEWS, 3))
    view = np.arange(RAYS) % VIEWS
    f = lambda a: jnp.asarray(a, jnp.float32)  # noqa: E731
    return Rays(f(centres[view]), f(rng.normal(size=(RAYS, 3))), f(np.full(RAYS, 1e-3)), jnp.asarray(view, jnp.int32))


def generator(twist: np.ndarray) -> np.ndarray:
    """(4, 4) of se(3)."""
    x, y, z = twist[3:]
    return np.array([[0, -z, y, twist[0]], [z, 0, -x, twist[1]], [-y, x, 0, twist[2]], [0, 0, 0, 0.0]])


def reference(rays: Rays, twists: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions in float64: the matrix exponential of each ray's twist, about the ray's own origin."""
    origins, directions = (np.array(a, np.float64) for a in (rays.origins, rays.directions))
    for i, view in enumerate(np.asarray(rays.view)):
        change = expm(generator(twists[view]))
        origins[i] += change[:3, 3]
        directions[i] = change[:3, :3] @ directions[i]
    return origins, directions


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-3, 0.1, 0.49, 0.51, 1.5, 3.0])
def test_rays_move_as_the_matrix_exponential_says(angle: float) -> None:
    """Float32 of numbers of order one: 1e-6; on both sides of where the series ends (0.5 rad)."""
    rng = np.random.default_rng(1)
    turn = rng.normal(size=(VIEWS, 3))
    twists = np.concatenate([rng.normal(size=(VIEWS, 3)), angle * turn / np.linalg.norm(turn, axis=-1, keepdims=True)], -1)
    twists = np.asarray(twists, np.float32)
    found = jax.jit(moved)(some_rays(), jnp.asarray(twists))
    origins, directions = reference(some_rays(), twists.astype(np.float64))
    np.testing.assert_allclose(found.origins, origins, atol=2e-6)
    np.testing.assert_allclose(found.directions, directions, atol=2e-6)


def test_no_twist_moves_nothing_and_none_costs_nothing() -> None:
    rays = some_rays()
    still = jax.jit(moved)(rays, jnp.zeros((VIEWS, 6)))
    np.testing.assert_array_equal(still.origins, rays.origins)
    np.testing.assert_array_equal(still.directions, rays.directions)
    assert moved(rays, None) is rays and followed(rays, None) is rays


def test_the_derivative_is_that_of_the_exponential() -> None:
    """Central differences of the float64 reference (error 1e-9); float32 slopes of order one: 2e-5. At zero as anywhere."""
    rays, rng = some_rays(), np.random.default_rng(2)
    weights = rng.normal(size=(2, RAYS, 3))
    measured = lambda o, d: (weights[0] * o).sum() + (weights[1] * d).sum()  # noqa: E731
    slopes_at = jax.jit(jax.grad(lambda x: measured(moved(rays, x).origins, moved(rays, x).directions)))
    for angle in (0.0, 1e-9, 0.02, 0.499, 0.7):
        turn = rng.normal(size=(VIEWS, 3))
        twists = np.concatenate([rng.normal(size=(VIEWS, 3)), angle * turn / np.linalg.norm(turn, axis=-1, keepdims=True)], -1)
        slopes, twists = slopes_at(jnp.asarray(twists, jnp.float32)), np.asarray(twists, np.float32).astype(np.float64)
        for view, component in ((0, 0), (1, 2), (2, 3), (3, 4), (4, 5)):
            step = np.zeros((VIEWS, 6))
            step[view, component] = 1e-5
            above, below = (measured(*reference(rays, twists + sign * step)) for sign in (1, -1))
            assert slopes[view, component] == pytest.approx((above - below) / 2e-5, abs=2e-5)


def test_rays_are_followed_with_the_gradient_of_a_further_twist() -> None:
    """Along t the identity, along w the cross product with the direction; the rays themselves keep their bits."""
    rays, twists = some_rays(), 0.01 * jax.random.normal(jax.random.key(0), (VIEWS, 6))
    here = moved(rays, twists)
    np.testing.assert_array_equal(followed(here, twists).origins, here.origins)
    np.testing.assert_array_equal(followed(here, twists).directions, here.directions)
    weights = jax.random.normal(jax.random.key(1), (2, RAYS, 3))

    def sums(x):
        return jnp.sum(weights[0] * followed(here, x).origins) + jnp.sum(weights[1] * followed(here, x).directions)

    slopes = jax.jit(jax.grad(sums))(twists)
    per_ray = np.concatenate([weights[0], np.cross(here.directions, weights[1])], -1)
    expected = np.zeros((VIEWS, 6))
    np.add.at(expected, np.asarray(rays.view), per_ray)
    np.testing.assert_allclose(slopes, expected, atol=1e-5)


def test_what_moves_turns_or_scales_all_cameras_alike_is_left_out() -> None:
    """Against least squares in float64."""
    rng = np.random.default_rng(3)
    origins, sigma = rng.normal(size=(VIEWS, 3)) + np.array([3.0, 0, 1]), np.asarray(SIGMA, np.float64)
    shift, turn, growth = rng.normal(size=3), rng.normal(size=3), rng.normal()
    as_one = np.concatenate([shift + np.cross(turn, origins) + growth * origins, np.tile(turn, (VIEWS, 1))], -1) / sigma
    f = lambda a: jnp.asarray(a, jnp.float32)  # noqa: E731
    left = jax.jit(without_gauge)(f(as_one / 1000), f(origins), SIGMA)
    assert np.abs(left).max() < 1e-5 * np.abs(as_one / 1000).max()

    basis = []
    for axis in np.eye(3):
        basis += [np.concatenate([np.tile(axis, (VIEWS, 1)), 0 * origins], -1)]
        basis += [np.concatenate([np.cross(axis, origins), np.tile(axis, (VIEWS, 1))], -1)]
    basis = np.stack([*basis, np.concatenate([origins, 0 * origins], -1)]).reshape(7, -1) / np.tile(sigma, VIEWS)
    values = rng.normal(size=(VIEWS, 6))
    best = np.linalg.lstsq(basis.T, values.reshape(-1), rcond=None)[0]
    np.testing.assert_allclose(
        jax.jit(without_gauge)(f(values), f(origins), SIGMA), values - (best @ basis).reshape(VIEWS, 6), atol=1e-5
    )


def test_one_camera_or_several_in_one_place_have_a_gauge_too() -> None:
    values = jax.random.normal(jax.random.key(0), (1, 6))
    np.testing.assert_allclose(without_gauge(values, jnp.ones((1, 3)), SIGMA), 0, atol=1e-5)
    together = gauge(jnp.ones((4, 3)), SIGMA)
    lengths = [float(jnp.sum(one * one)) for one in together]
    np.testing.assert_allclose(lengths, [1, 1, 1, 1, 1, 1, 0], atol=1e-5)
    assert np.isfinite(without_gauge(jnp.ones((4, 6)), jnp.ones((4, 3)), SIGMA)).all()
