import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.twists import followed, gauge, moved, together, without_gauge
from tests import drawn

VIEWS, RAYS = 7, 60
SIGMA = np.float32([5e-3] * 3 + [9e-4] * 3)
MOVED = jax.jit(moved)
WITHOUT_GAUGE = jax.jit(without_gauge)


def some_rays(seed: int = 0) -> Rays:
    """Rays of a few views, a unit or so from the origin."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(VIEWS, 3))
    view = np.arange(RAYS) % VIEWS
    f = drawn.array
    return Rays(f(centres[view]), f(rng.normal(size=(RAYS, 3))), f(np.full(RAYS, 1e-3)), f(view, np.int32))


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
    found = MOVED(some_rays(), twists)
    origins, directions = reference(some_rays(), twists.astype(np.float64))
    np.testing.assert_allclose(found.origins, origins, atol=2e-6)
    np.testing.assert_allclose(found.directions, directions, atol=2e-6)


def test_a_motion_of_all_cameras_is_one_motion() -> None:
    """The matrix exponential of each camera's twist about itself is that of the one twist about the middle."""
    rng = np.random.default_rng(2)
    origins, middle, root = 3 * rng.normal(size=(5, 3)), rng.normal(size=3), 0.1 * rng.normal(size=(6, 6))
    spread = together(origins, middle, root @ root.T)
    about = together(middle[None], middle, root @ root.T)[0]
    np.testing.assert_allclose(about @ about.T, root @ root.T, atol=1e-12)
    by = rng.normal(size=6)

    def motion(twist: np.ndarray, place: np.ndarray) -> np.ndarray:
        there, back = np.eye(4), np.eye(4)
        there[:3, 3], back[:3, 3] = place, -place
        return there @ expm(generator(twist)) @ back

    for one, origin in zip(spread, origins, strict=True):
        np.testing.assert_allclose(motion(one @ by, origin), motion(about @ by, middle), atol=1e-10)


def test_no_twist_moves_nothing_and_none_costs_nothing() -> None:
    rays = some_rays()
    still = MOVED(rays, np.zeros((VIEWS, 6), np.float32))
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
        slopes, twists = np.asarray(slopes_at(np.float32(twists))), np.float32(twists).astype(np.float64)
        for view, component in ((0, 0), (1, 2), (2, 3), (3, 4), (4, 5)):
            step = np.zeros((VIEWS, 6))
            step[view, component] = 1e-5
            above, below = (measured(*reference(rays, twists + sign * step)) for sign in (1, -1))
            assert slopes[view, component] == pytest.approx((above - below) / 2e-5, abs=2e-5)


def test_rays_are_followed_with_the_gradient_of_a_further_twist() -> None:
    """Along t the identity, along w the cross product with the direction; the rays themselves keep their bits."""
    rays, twists, weights = some_rays(), 0.01 * np.asarray(drawn.normal(VIEWS, 6)), np.asarray(drawn.normal(2, RAYS, 3, seed=1))

    @jax.jit
    def evaluated(rays: Rays, twists: jax.Array) -> tuple[Rays, Rays, jax.Array]:
        """Rays that were moved, the same followed, and the slopes of what is measured of those."""
        here = moved(rays, twists)
        back = lambda x: followed(here, x)  # noqa: E731
        sums = lambda x: jnp.sum(weights[0] * back(x).origins) + jnp.sum(weights[1] * back(x).directions)  # noqa: E731
        return here, back(twists), jax.grad(sums)(twists)

    here, again, slopes = jax.tree.map(np.asarray, evaluated(rays, twists))
    np.testing.assert_array_equal(again.origins, here.origins)
    np.testing.assert_array_equal(again.directions, here.directions)
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
    left = WITHOUT_GAUGE(np.float32(as_one / 1000), np.float32(origins), SIGMA)
    assert np.abs(left).max() < 1e-5 * np.abs(as_one / 1000).max()

    basis = []
    for axis in np.eye(3):
        basis += [np.concatenate([np.tile(axis, (VIEWS, 1)), 0 * origins], -1)]
        basis += [np.concatenate([np.cross(axis, origins), np.tile(axis, (VIEWS, 1))], -1)]
    basis = np.stack([*basis, np.concatenate([origins, 0 * origins], -1)]).reshape(7, -1) / np.tile(sigma, VIEWS)
    values = rng.normal(size=(VIEWS, 6))
    best = np.linalg.lstsq(basis.T, values.reshape(-1), rcond=None)[0]
    found = WITHOUT_GAUGE(np.float32(values), np.float32(origins), SIGMA)
    np.testing.assert_allclose(found, values - (best @ basis).reshape(VIEWS, 6), atol=1e-5)


def test_one_camera_or_several_in_one_place_have_a_gauge_too() -> None:
    ones = np.ones((VIEWS, 3), np.float32)
    np.testing.assert_allclose(WITHOUT_GAUGE(drawn.normal(1, 6), ones[:1], SIGMA), 0, atol=1e-5)
    together = np.stack(jax.jit(gauge)(ones, SIGMA))
    np.testing.assert_allclose((together**2).sum((1, 2)), [1, 1, 1, 1, 1, 1, 0], atol=1e-5)
    assert np.isfinite(WITHOUT_GAUGE(np.ones((VIEWS, 6), np.float32), ones, SIGMA)).all()
