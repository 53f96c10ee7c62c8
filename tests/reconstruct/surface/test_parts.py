"""The bias for two kinds of surface, seen by the cameras of a batch."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.field.field import Field
from reconstruct.field.near import Near
from reconstruct.models import load_config
from reconstruct.rendering.model import Model
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.rays import Normalisation, Rays
from reconstruct.scene.space import BALL, BOX
from reconstruct.surface import regularisers
from reconstruct.surface.first_surface import Surface
from reconstruct.surface.parts import bias_for_two_kinds, kinds_told_apart, towards_surface
from reconstruct.surface.place import Place

SMALL = ["encoding.levels=2", "encoding.log2_size=6", "field.spatial_width=8", "field.view_width=8", "field.view_depth=1"]
FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.5))
PLACE = Place(BOX)


@pytest.fixture
def field() -> Field:
    """A reflection that differs from place to place and from side to side."""
    made = Model.create(jax.random.key(0), load_config(overrides=[*SMALL, "sampler.grid=8"]), FACTS).field
    arrays, static = eqx.partition(made, eqx.is_inexact_array)
    leaves, tree = jax.tree.flatten(arrays)
    random = np.random.default_rng(0)
    leaves = [jnp.asarray(random.normal(size=leaf.shape) * 0.7, jnp.float32) for leaf in leaves]
    return eqx.combine(jax.tree.unflatten(tree, leaves), static)


@pytest.fixture
def rays() -> Rays:
    """From four sides to near the origin."""
    origins = np.array([[2.0, 0, 0], [0, 2, 0], [0, 0, 2], [-1.5, 1, 1]])
    aim = np.array([[0.1, 0.2, 0], [0, 0.1, 0.1], [0.3, 0, 0], [0, -0.2, 0.1]]) - origins
    return Rays(
        *(jnp.asarray(a, jnp.float32) for a in (origins, aim / np.linalg.norm(aim, axis=1, keepdims=True))), jnp.full(4, 0.01)
    )


@pytest.fixture
def surface() -> Surface:
    """Of the third ray and the first."""
    return Surface(jnp.array([2, 0], jnp.int32), jnp.array([1.9, 1.8]), jnp.ones(2), jnp.full(2, 0.1))


def test_it_looks_from_every_camera_at_every_point(field: Field, rays: Rays, surface: Surface) -> None:
    _, material = field(PLACE.of(rays, surface))
    seen = np.zeros((2, 4, 3), np.float32)
    for point in range(2):
        place = rays.origins[surface.ray[point]] + rays.directions[surface.ray[point]] * surface.t[point]
        alone = jax.tree.map(lambda a, point=point: a[:, point : point + 1], material)
        for camera in range(4):
            direction = place - rays.origins[camera]
            direction = direction / jnp.linalg.norm(direction)
            direction = direction * jnp.where(direction @ material.normals_pred[:, point] > 0, -1, 1)
            seen[point, camera] = field.shade(alone, direction[:, None], near=Near(place[:, None])).specular[:, 0]
    assert np.ptp(seen, axis=1).max() > 0.01, "the premise: sides differ"
    expected = regularisers.metal_or_not(material.diffuse.T, jnp.asarray(seen))
    np.testing.assert_allclose(bias_for_two_kinds(field, PLACE, rays, surface), expected, rtol=1e-4)


def test_directions_go_into_the_surface(rays: Rays, surface: Surface) -> None:
    normals = jnp.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0]])
    towards = towards_surface(PLACE.of(rays, surface).points, rays.origins, normals)
    np.testing.assert_allclose(jnp.linalg.norm(towards, axis=-1), 1, rtol=1e-6)
    assert (jnp.einsum("ncx,xn->nc", towards, normals) <= 0).all()


def test_an_object_among_surroundings_waits_for_its_reflections(rays: Rays) -> None:
    """One point in the object's ball, one outside it; before a blank background, or in a common frustum, none waits."""
    points = Surface(jnp.array([0, 1], jnp.int32), jnp.array([1.9, 0.5]), jnp.ones(2), jnp.full(2, 0.1))
    np.testing.assert_array_equal(kinds_told_apart(Place(BALL), rays, points, 0.25), [0.25, 1])
    np.testing.assert_array_equal(kinds_told_apart(Place(BALL), rays, points, 1.0), [1, 1])
    assert kinds_told_apart(PLACE, rays, points, 0.25) == 1


@pytest.mark.parametrize("place", [PLACE, Place(BALL)])
def test_neither_shape_nor_light_has_a_gradient(field: Field, rays: Rays, surface: Surface, place: Place) -> None:
    """Of the spatial network's last layer only diffuse colour and tint feel it; the features before, and the light, nothing."""
    gradient = eqx.filter_grad(lambda field: jnp.sum(bias_for_two_kinds(field, place, rays, surface)))(field)
    held = (gradient.appearance, gradient.encoding, gradient.spatial.weights[:-1], gradient.spatial.biases[:-1])
    assert all((leaf == 0).all() for leaf in jax.tree.leaves(held))
    last = gradient.spatial.weights[-1]  # outputs first: density, diffuse (3), tint (3), roughness, normal (3), bottleneck
    outputs = np.abs(np.asarray(last)).max(axis=1)
    assert (outputs[1:7] > 0).any() and (outputs[0] == 0).all() and (outputs[7:] == 0).all()
