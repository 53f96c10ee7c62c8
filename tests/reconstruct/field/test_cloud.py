import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.field.cloud import (
    GAUSSIAN_SCALE,
    Cloud,
    _perpendicular,
    gaussians_in_frustums,
    hexagons_in_frustums,
    points_on_rays,
)
from reconstruct.field.encodings.lattice import PermutohedralLattice
from reconstruct.scene.contraction import contract, contraction_scale
from reconstruct.scene.rays import Rays
from reconstruct.scene.space import BALL, BOX

HEXAGONS = jax.jit(hexagons_in_frustums, static_argnums=3)


def some_rays(count: int = 5) -> Rays:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(count, 3))
    directions[0], directions[1] = [0, 0, -1.0], [0, 0, 2.0]
    return Rays(*(jnp.asarray(a, jnp.float32) for a in (rng.normal(size=(count, 3)), directions)), jnp.full(count, 0.05))


def frustum_moments(t0: float, t1: float, radius: float) -> tuple[float, float, float]:
    """Mean and variance of t, and variance along each axis across, of a uniform conical frustum; numerically."""
    t = t0 + (t1 - t0) * (np.arange(20000) + 0.5) / 20000
    mean = np.average(t, weights=t**2)
    return mean, np.average((t - mean) ** 2, weights=t**2), np.average((radius * t) ** 2 / 4, weights=t**2)


@pytest.mark.parametrize(("t0", "t1"), [(1.0, 1.2), (0.5, 3.0), (1e-4, 1.0)])
def test_hexagons_match_the_frustum_s_mean_and_covariance(t0: float, t1: float) -> None:
    """Each hexagon matches mean, variance along and total variance across; over all turns the covariance is the frustum's."""
    rays, turns = some_rays(), 12
    repeated = jax.tree.map(lambda a: jnp.repeat(a, turns, 0), rays)
    turn = jnp.tile(jnp.arange(turns) * 2 * np.pi / turns, 5)
    cloud = HEXAGONS(repeated, jnp.broadcast_to(jnp.array([t0, t1]), (5 * turns, 2)), turn, BOX)
    assert cloud.group == 6
    points = np.asarray(cloud.points, np.float64).T.reshape(5, turns, 6, 3)
    mean_t, var_t, var_r = frustum_moments(t0, t1, 0.05)
    for ray in range(5):
        origin, direction = (np.asarray(a[ray], np.float64) for a in (rays.origins, rays.directions))
        forward = direction / np.linalg.norm(direction)
        offsets = points[ray] - (origin + mean_t * direction)
        np.testing.assert_allclose(offsets.mean(1), 0, atol=3e-6)  # float32 of coordinates up to 6
        np.testing.assert_allclose(np.mean((offsets @ forward) ** 2, -1), var_t * (direction @ direction), rtol=1e-4)
        across = offsets - (offsets @ forward)[..., None] * forward
        np.testing.assert_allclose(np.mean(np.sum(across**2, -1), -1), 2 * var_r, rtol=1e-3)
        expected = var_t * np.outer(direction, direction) + var_r * (np.eye(3) - np.outer(forward, forward))
        flat = offsets.reshape(-1, 3)
        np.testing.assert_allclose(flat.T @ flat / len(flat), expected, atol=1e-3 * var_r + 1e-5 * var_t)


def test_gaussians_are_as_wide_as_their_distance_asks() -> None:
    rays = some_rays()
    cloud = HEXAGONS(rays, jnp.broadcast_to(jnp.array([1.0, 1.5, 2.5]), (5, 3)), jnp.zeros(5), BOX)
    t = (
        np.sum((np.asarray(cloud.points).T.reshape(5, 12, 3) - rays.origins[:, None]) * rays.directions[:, None], -1)
        / np.sum(rays.directions**2, -1)[:, None]
    )
    np.testing.assert_allclose(np.asarray(cloud.scale).reshape(5, 12), GAUSSIAN_SCALE * 0.05 * t / np.sqrt(2), rtol=1e-5)


def test_intervals_of_no_length_are_finite() -> None:
    cloud = HEXAGONS(some_rays(), jnp.zeros((5, 3)), jnp.zeros(5), BALL)
    assert np.isfinite(cloud.points).all()
    np.testing.assert_array_equal(cloud.scale, 0)


def test_perpendicular_vectors_are_orthonormal() -> None:
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions[:4] = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [1e-4, 0, -1]]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    frame = np.stack([directions, *_perpendicular(jnp.asarray(directions, jnp.float32))], -2)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frame.shape), atol=1e-5)


def test_points_lie_on_their_rays() -> None:
    rays = some_rays()
    cloud = points_on_rays(rays, jnp.array([2, 0, 2]), jnp.array([1.0, 2.0, 3.0]), BOX)
    expected = np.asarray(rays.origins)[[2, 0, 2]] + np.array([[1.0], [2], [3]]) * np.asarray(rays.directions)[[2, 0, 2]]
    np.testing.assert_allclose(cloud.points.T, expected, atol=1e-6)
    assert cloud.scale is None


def test_features_are_averaged_over_groups_in_contracted_space() -> None:
    lattice = PermutohedralLattice.create(jax.random.key(0), levels=2, features=2, log2_size=8, coarsest=2.0, finest=4.0)
    points, scale = jax.random.normal(jax.random.key(1), (3, 18)) * 3, jnp.linspace(0.01, 0.2, 18)
    assert (jnp.linalg.norm(points, axis=0) > 1).any()
    features = jax.jit(lambda c: c.encoded(lattice))(Cloud(points, scale, BALL, 6))
    plain = jax.jit(lattice.__call__)(contract(points.T).T, scale * contraction_scale(points.T))
    np.testing.assert_allclose(features, plain.reshape(4, 3, 6).mean(-1), atol=1e-9)
    averaged, jacobian = jax.jit(lambda c: c.encoded_with_jacobian(lattice))(Cloud(points, scale, BALL, 6))
    np.testing.assert_allclose(averaged, features, atol=1e-9)
    assert jacobian.shape == (4, 3, 18)


@pytest.mark.parametrize("group", [pytest.param(1, marks=pytest.mark.slow), 6])
def test_points_that_are_followed_get_the_gradient_of_the_features(group: int) -> None:
    """Against the analytic derivative to the scene's coordinates, inside and outside the unit ball; elsewhere points are data."""
    lattice = PermutohedralLattice.create(jax.random.key(0), levels=2, features=2, log2_size=8, coarsest=2.0, finest=4.0)
    lattice = eqx.tree_at(lambda e: e.table, lattice, jax.random.normal(jax.random.key(2), lattice.table.shape))
    points, weights = jax.random.normal(jax.random.key(1), (3, 18)) * 0.6, jax.random.normal(jax.random.key(3), (4, 18 // group))
    lengths = jnp.linalg.norm(points, axis=0)
    assert (lengths > 1).any() and (lengths < 1).any()
    encoded = jax.jit(lambda p, followed: Cloud(p, None, BALL, group, followed).encoded(lattice), static_argnums=1)
    np.testing.assert_allclose(encoded(points, True), encoded(points, False), atol=1e-6)  # sums in another order
    slopes = [jax.grad(lambda p, f=followed: jnp.sum(weights * encoded(p, f)))(points) for followed in (True, False)]
    expected = np.asarray(
        jax.jit(lambda c: c.gradient(weights, c.encoded_with_jacobian(lattice)[1]))(Cloud(points, None, BALL, group))
    )
    np.testing.assert_allclose(slopes[0].reshape(3, -1, group).sum(-1), expected, atol=1e-5 * np.abs(expected).max())
    assert np.abs(expected).max() > 0.1 and not slopes[1].any()


@pytest.mark.parametrize(("t0", "t1"), [(1.0, 1.2), (0.5, 3.0), (1e-3, 1.0), (2.0, 2.0)])
def test_one_gaussian_has_the_frustum_s_mean_and_variances(t0: float, t1: float) -> None:
    """Mean, and the diagonal of the covariance, of a uniform conical frustum by numerical integration."""
    rays = some_rays()
    middle, half = jnp.full(5, (t0 + t1) / 2), jnp.full(5, (t1 - t0) / 2)
    cloud = jax.jit(gaussians_in_frustums, static_argnums=4)(rays, jnp.arange(5), middle, half, BOX)
    mean_t, var_t, var_r = frustum_moments(t0, t1, 0.05)
    origins, directions = (np.asarray(a, np.float64) for a in (rays.origins, rays.directions))
    np.testing.assert_allclose(cloud.points.T, origins + mean_t * directions, atol=3e-6)
    squared = directions**2
    expected = var_t * squared + var_r * (1 - squared / squared.sum(-1, keepdims=True))
    np.testing.assert_allclose(np.asarray(cloud.scale.T) ** 2, expected, rtol=2e-3, atol=2e-8)  # at (2, 2) of float32 rounding
    assert cloud.scale.shape == (3, 5) and cloud.group == 1


@pytest.mark.parametrize("group", [1, 6])
def test_some_of_the_places_keep_their_gaussians(group: int) -> None:
    points, scale = jax.random.normal(jax.random.key(2), (3, 5 * group)), jnp.linspace(0.01, 0.2, 5 * group)
    some = Cloud(points, scale, BOX, group).of(jnp.array([3, 0, 3]))
    entries = np.concatenate([np.arange(i * group, (i + 1) * group) for i in (3, 0, 3)])
    np.testing.assert_array_equal(some.points, points[:, entries])
    np.testing.assert_array_equal(some.scale, scale[entries])
    assert some.group == group and Cloud(points, None, BOX, group).of(jnp.array([1])).scale is None
