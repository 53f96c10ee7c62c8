import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import EncodingConfig, FieldConfig
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.scene.space import BALL, BOX
from tests import drawn

ENCODING = EncodingConfig(levels=3, features=2, log2_size=10, coarsest=2, finest=8)
FIELD = FieldConfig(spatial_width=16, bottleneck=4, view_width=16, ide_degree=3)


@pytest.fixture(scope="module")
def field() -> Field:
    """A small field whose table holds values of order one, so that density varies."""
    made = drawn.filled(lambda: Field.create(jax.random.key(0), ENCODING, FIELD))
    return eqx.tree_at(lambda f: f.encoding.table, made, drawn.uniform(*made.encoding.table.shape, low=-0.3, high=0.3))


@jax.jit
def with_normals(field: Field, cloud: Cloud):
    return field.with_normals(cloud)


@jax.jit
def density(field: Field, cloud: Cloud) -> jax.Array:
    return field.density(cloud)


@pytest.mark.parametrize("bounded", [True, False])
def test_normals_point_against_the_density_s_differences(field: Field, bounded: bool) -> None:
    """Log density is linear inside simplices and between the network's kinks: there central differences are its gradient.

    float32 rounding leaves about 2e-7 / 4e-4 of slopes of order one, which turns the normal by less than 0.2 degrees.
    """
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.9, 0.9, (3, 600)) if bounded else rng.normal(size=(3, 600)) * 2
    space, step = BOX if bounded else BALL, 4e-4
    found, _, normals = with_normals(field, Cloud(drawn.array(points), None, space))
    raw = lambda p: np.log(np.asarray(density(field, Cloud(drawn.array(p), None, space))))  # noqa: E731
    here = raw(points)
    gradient, usable = np.zeros((3, 600)), np.ones(600, bool)
    for axis in range(3):
        offset = np.eye(3)[axis][:, None] * step
        before, after = (raw(points + sign * offset) for sign in (-1, 1))
        gradient[axis] = (after - before) / (2 * step)
        usable &= np.abs((after - here) - (here - before)) < 2e-6
    usable &= np.linalg.norm(gradient, axis=0) > 0.3
    assert usable.sum() > 50, "enough points must lie away from kinks"
    expected = -gradient / np.maximum(np.linalg.norm(gradient, axis=0), 1e-9)
    angle = np.degrees(np.linalg.norm(expected - np.asarray(normals), axis=0))
    assert angle[usable].max() < 1
    np.testing.assert_allclose(np.linalg.norm(normals, axis=0), 1, atol=1e-5)
    np.testing.assert_allclose(found, np.exp(here), rtol=1e-5)


def test_gradients_are_finite_where_the_field_is_flat() -> None:
    """A table of zeros has no density gradient and no predicted normal: both normals are zero, nothing is NaN."""
    empty = jax.tree.map(np.zeros_like, drawn.filled(lambda: Field.create(jax.random.key(0), ENCODING, FIELD)))

    def total(field: Field) -> jax.Array:
        density, material, normals = field.with_normals(Cloud(jnp.zeros((3, 4)), None, BALL))
        shading = field.shade(material, jnp.ones((3, 4)) / np.sqrt(3))
        return jnp.sum(density) + jnp.sum(normals**2) + jnp.sum(shading.rgb) + jnp.sum(material.stacked())

    value, gradient = jax.jit(jax.value_and_grad(total))(empty)
    assert np.isfinite(value)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
