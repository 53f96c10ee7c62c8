import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import EncodingConfig, FieldConfig
from koala3d.reconstruct.field import outline
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.outline import Outline
from koala3d.reconstruct.numerics.volume import SURFACE
from koala3d.reconstruct.sampling.occupancy import cell_centres
from koala3d.reconstruct.scene.space import BOX
from tests import drawn

RADIUS = 0.6


@pytest.fixture(scope="module")
def ball() -> Outline:
    """The outline of a ball."""
    return Outline.of(np.linalg.norm(cell_centres(outline.GRID, 1.0), axis=-1).reshape((outline.GRID,) * 3) - RADIUS)


def at_radii(*radii: float) -> tuple[np.ndarray, np.ndarray]:
    """(3, 200 per radius) points at these distances from the middle, and their directions."""
    directions = np.random.default_rng(0).normal(size=(3, 200))
    directions /= np.linalg.norm(directions, axis=0)
    return np.concatenate([radius * directions for radius in radii], 1), np.tile(directions, len(radii))


def test_the_surface_is_where_the_distance_is_zero(ball: Outline) -> None:
    """There half of the light is gone."""
    points, _ = at_radii(RADIUS)
    density = np.exp(ball.log_density(jnp.zeros(200), drawn.array(points)))
    # between points of the grid the distance is too small by up to CELL^2 / (4 RADIUS) = 4e-4, in float16: 2 % of WIDTH
    np.testing.assert_allclose(np.exp(-SURFACE * density), 0.5, atol=0.02)


def test_it_is_opaque_inside_and_fog_outside(ball: Outline) -> None:
    inside, outside = (np.asarray(ball.log_density(jnp.zeros(200), drawn.array(at_radii(r)[0]))) for r in (0.3, 0.95))
    np.testing.assert_allclose(inside, outline.INSIDE, atol=0.05)  # beyond the bounds it leaks by a thousandth
    np.testing.assert_allclose(outside, outline.OUTSIDE, atol=0.05)


def test_without_masks_it_is_fog_everywhere() -> None:
    points, _ = at_radii(0.0, 0.5, 0.9)
    np.testing.assert_allclose(Outline.of(None).log_density(jnp.zeros(600), drawn.array(points)), outline.OUTSIDE, atol=0.05)


def test_normals_point_away_from_the_ball(ball: Outline) -> None:
    """Within the band and beyond it, before the network adds anything."""
    points, directions = at_radii(0.4, RADIUS, 0.8)
    slope = np.asarray(ball.slope(jnp.zeros((3, 600)), drawn.array(points)))
    cosines = -np.sum(slope / np.linalg.norm(slope, axis=0) * directions, 0)
    assert cosines.min() > np.cos(np.deg2rad(3))  # differences over two cells of a ball of 20 cells' radius


def test_a_field_s_normals_are_those_of_the_sum(ball: Outline) -> None:
    """Against differences of the log density over a cell: that is how the outline's slope is defined."""
    encoding = EncodingConfig(levels=1, features=2, log2_size=10, coarsest=1, finest=1)
    field = drawn.filled(lambda: Field.create(jax.random.key(0), encoding, FieldConfig(spatial_width=16), outline=ball))
    field = eqx.tree_at(lambda f: f.outline, field, eqx.tree_at(lambda o: o.gain, ball, jnp.asarray(2.0)))
    points, _ = at_radii(RADIUS)
    _, _, normals = field.with_normals(Cloud(drawn.array(points), None, BOX))
    log = lambda p: np.log(np.asarray(field.density(Cloud(drawn.array(p), None, BOX))))  # noqa: E731
    steps = outline.CELL * np.eye(3)[:, :, None]
    gradient = np.stack([log(points + step) - log(points - step) for step in steps])
    expected = -gradient / np.linalg.norm(gradient, axis=0)
    assert np.sum(expected * np.asarray(normals), 0).min() > np.cos(np.deg2rad(5))  # the network bends within a cell


def test_the_gain_decides_how_much_the_network_adds(ball: Outline) -> None:
    points, raw = drawn.array(at_radii(RADIUS)[0]), drawn.uniform(200, low=-1, high=1)
    begun = ball.log_density(raw, points)
    freed = eqx.tree_at(lambda o: o.gain, ball, jnp.asarray(3.0)).log_density(raw, points)
    np.testing.assert_allclose(freed - begun, 3 * np.asarray(raw), atol=1e-5)
    slope = jnp.ones((3, 200))
    np.testing.assert_allclose(
        eqx.tree_at(lambda o: o.gain, ball, jnp.asarray(3.0)).slope(slope, points) - ball.slope(slope, points), 3, atol=1e-3
    )
