import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.cloud import (
    GAUSSIAN_SCALE,
    Cloud,
    _perpendicular,
    gaussians_in_frustums,
    hexagons_in_frustums,
    points_on_rays,
)
from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice
from koala3d.reconstruct.scene.contraction import contract, contraction_scale
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import BALL, BOX
from tests import drawn

HEXAGONS = jax.jit(hexagons_in_frustums, static_argnums=3)
GAUSSIANS = jax.jit(gaussians_in_frustums, static_argnums=4)


def some_rays(count: int = 5) -> Rays:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(count, 3))
    directions[0], directions[1] = [0, 0, -1.0], [0, 0, 2.0]
    return Rays(*(drawn.array(a) for a in (rng.normal(size=(count, 3)), directions, np.full(count, 0.05))))


def frustum_moments(t0: float, t1: float, radius: float) -> tuple[float, float, float]:
    """Mean and variance of t, and variance along each axis across, of a uniform conical frustum; numerically."""
    t = t0 + (t1 - t0) * (np.arange(20000) + 0.5) / 20000
    mean = np.average(t, weights=t**2)
    return mean, np.average((t - mean) ** 2, weights=t**2), np.average((radius * t) ** 2 / 4, weights=t**2)


@pytest.mark.parametrize(("t0", "t1"), [(1.0, 1.2), (0.5, 3.0), (1e-4, 1.0)])
def test_hexagons_match_the_frustum_s_mean_and_covariance(t0: float, t1: float) -> None:
    """Each hexagon matches mean, variance along and total variance across; over all turns the covariance is the frustum's."""
    rays, turns = some_rays(), 12
    repeated = jax.tree.map(lambda a: np.repeat(a, turns, 0), rays)
    turn = np.tile(np.arange(turns) * 2 * np.pi / turns, 5)
    cloud = HEXAGONS(repeated, np.tile(np.float32([t0, t1]), (5 * turns, 1)), np.float32(turn), BOX)
    assert cloud.group == 6
    points = np.asarray(cloud.points, np.float64).T.reshape(5, turns, 6, 3)
    mean_t, var_t, var_r = frustum_moments(t0, t1, 0.05)
    for ray in range(5):
        origin, direction = (np.asarray(a, np.float64)[ray] for a in (rays.origins, rays.directions))
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
    cloud = HEXAGONS(rays, np.tile(np.float32([1.0, 1.5, 2.5]), (5, 1)), np.zeros(5, np.float32), BOX)
    origins, directions = np.asarray(rays.origins)[:, None], np.asarray(rays.directions)[:, None]
    t = np.sum((np.asarray(cloud.points).T.reshape(5, 12, 3) - origins) * directions, -1) / np.sum(directions**2, -1)
    np.testing.assert_allclose(np.asarray(cloud.scale).reshape(5, 12), GAUSSIAN_SCALE * 0.05 * t / np.sqrt(2), rtol=1e-5)


def test_intervals_of_no_length_are_finite() -> None:
    cloud = HEXAGONS(some_rays(), np.zeros((5, 3), np.float32), np.zeros(5, np.float32), BALL)
    assert np.isfinite(cloud.points).all()
    np.testing.assert_array_equal(cloud.scale, 0)


def test_perpendicular_vectors_are_orthonormal() -> None:
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions[:4] = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [1e-4, 0, -1]]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    frame = np.stack([directions, *jax.jit(_perpendicular)(np.float32(directions))], -2)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frame.shape), atol=1e-5)


def test_points_lie_on_their_rays() -> None:
    rays = some_rays()
    cloud = jax.jit(points_on_rays, static_argnums=3)(rays, np.int32([2, 0, 2]), np.float32([1.0, 2.0, 3.0]), BOX)
    expected = np.asarray(rays.origins)[[2, 0, 2]] + np.array([[1.0], [2], [3]]) * np.asarray(rays.directions)[[2, 0, 2]]
    np.testing.assert_allclose(np.asarray(cloud.points).T, expected, atol=1e-6)
    assert cloud.scale is None


@pytest.fixture(scope="module")
def lattice() -> PermutohedralLattice:
    sizes = {"levels": 2, "features": 2, "log2_size": 8, "coarsest": 2.0, "finest": 4.0}
    made = drawn.filled(lambda: PermutohedralLattice.create(jax.random.key(0), **sizes))
    return eqx.tree_at(lambda e: e.table, made, drawn.normal(*made.table.shape, seed=2))


def test_features_are_averaged_over_groups_in_contracted_space(lattice: PermutohedralLattice) -> None:
    points, scale = np.asarray(drawn.normal(3, 18)) * 3, np.linspace(0.01, 0.2, 18, dtype=np.float32)
    assert (np.linalg.norm(points, axis=0) > 1).any()

    @jax.jit
    def evaluated(points: jax.Array, scale: jax.Array) -> tuple[jax.Array, ...]:
        cloud = Cloud(points, scale, BALL, 6)
        plain = lattice(contract(points.T).T, scale * contraction_scale(points.T))
        return plain, cloud.encoded(lattice), *cloud.encoded_with_jacobian(lattice)

    plain, features, averaged, jacobian = evaluated(points, scale)
    np.testing.assert_allclose(features, np.asarray(plain).reshape(4, 3, 6).mean(-1), atol=1e-6)  # float32 of order one
    np.testing.assert_allclose(averaged, features, atol=1e-6)
    assert jacobian.shape == (4, 3, 18)


@pytest.mark.parametrize("group", [pytest.param(1, marks=pytest.mark.slow), 6])
def test_points_that_are_followed_get_the_gradient_of_the_features(lattice: PermutohedralLattice, group: int) -> None:
    """Against the analytic derivative to the scene's coordinates, inside and outside the unit ball; elsewhere points are data."""
    points, weights = 0.6 * np.asarray(drawn.normal(3, 18, seed=1)), np.asarray(drawn.normal(4, 18 // group, seed=3))
    lengths = np.linalg.norm(points, axis=0)
    assert (lengths > 1).any() and (lengths < 1).any()

    @jax.jit
    def evaluated(points: jax.Array) -> tuple[list[tuple[jax.Array, jax.Array]], jax.Array]:
        """Features and slopes of points that are followed and of others; and the analytic slopes."""
        encoded = lambda p, followed: Cloud(p, None, BALL, group, followed).encoded(lattice)  # noqa: E731
        pulled = [jax.vjp(lambda p, f=followed: encoded(p, f), points) for followed in (True, False)]
        cloud = Cloud(points, None, BALL, group)
        analytic = cloud.gradient(jnp.asarray(weights), cloud.encoded_with_jacobian(lattice)[1])
        return [(value, pull(jnp.asarray(weights))[0]) for value, pull in pulled], analytic

    ((followed, slopes), (others, none)), expected = jax.tree.map(np.asarray, evaluated(points))
    np.testing.assert_allclose(followed, others, atol=1e-6)  # sums in another order
    np.testing.assert_allclose(slopes.reshape(3, -1, group).sum(-1), expected, atol=1e-5 * np.abs(expected).max())
    assert np.abs(expected).max() > 0.1 and not none.any()


@pytest.mark.parametrize(("t0", "t1"), [(1.0, 1.2), (0.5, 3.0), (1e-3, 1.0), (2.0, 2.0)])
def test_one_gaussian_has_the_frustum_s_mean_and_variances(t0: float, t1: float) -> None:
    """Mean, and the diagonal of the covariance, of a uniform conical frustum by numerical integration."""
    rays = some_rays()
    middle, half = np.full(5, (t0 + t1) / 2, np.float32), np.full(5, (t1 - t0) / 2, np.float32)
    cloud = jax.tree.map(np.asarray, GAUSSIANS(rays, np.arange(5, dtype=np.int32), middle, half, BOX))
    mean_t, var_t, var_r = frustum_moments(t0, t1, 0.05)
    origins, directions = (np.asarray(a, np.float64) for a in (rays.origins, rays.directions))
    np.testing.assert_allclose(cloud.points.T, origins + mean_t * directions, atol=3e-6)
    squared = directions**2
    expected = var_t * squared + var_r * (1 - squared / squared.sum(-1, keepdims=True))
    np.testing.assert_allclose(np.asarray(cloud.scale.T) ** 2, expected, rtol=2e-3, atol=2e-8)  # at (2, 2) of float32 rounding
    assert cloud.scale.shape == (3, 5) and cloud.group == 1


@pytest.mark.parametrize("group", [1, 6])
def test_some_of_the_places_keep_their_gaussians(group: int) -> None:
    points, scale = drawn.normal(3, 5 * group), np.linspace(0.01, 0.2, 5 * group, dtype=np.float32)
    chosen = np.int32([3, 0, 3])
    some, plain = jax.jit(lambda p, s, i: (Cloud(p, s, BOX, group).of(i), Cloud(p, None, BOX, group).of(i)))(
        points, scale, chosen
    )
    entries = np.concatenate([np.arange(i * group, (i + 1) * group) for i in chosen])
    np.testing.assert_array_equal(some.points, np.asarray(points)[:, entries])
    np.testing.assert_array_equal(some.scale, scale[entries])
    assert some.group == group and plain.scale is None
