"""The bias for two kinds of surface, seen by the cameras of a batch."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Rays
from koala3d.reconstruct.scene.space import BALL, BOX
from koala3d.reconstruct.surface import regularisers
from koala3d.reconstruct.surface.first_surface import Surface
from koala3d.reconstruct.surface.parts import at_object, bias_for_two_kinds, towards_surface
from koala3d.reconstruct.surface.place import Place
from tests import drawn

SMALL = [
    "encoding.levels=2",
    "encoding.log2_size=6",
    "field.spatial_width=8",
    "field.view_width=8",
    "field.view_depth=1",
    "field.ide_degree=2",
]
FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.5))
PLACE = Place(BOX)


@pytest.fixture(scope="module")
def field() -> Field:
    """A reflection that differs from place to place and from side to side."""
    config = load_config(overrides=[*SMALL, "sampler.grid=8"])
    made = drawn.filled(lambda: Model.create(jax.random.key(0), config, FACTS).field)
    table = drawn.normal(*made.encoding.table.shape)
    return eqx.tree_at(lambda one: one.encoding.table, made, table)


@pytest.fixture(scope="module")
def rays() -> Rays:
    """From four sides to near the origin."""
    origins = np.array([[2.0, 0, 0], [0, 2, 0], [0, 0, 2], [-1.5, 1, 1]])
    aim = np.array([[0.1, 0.2, 0], [0, 0.1, 0.1], [0.3, 0, 0], [0, -0.2, 0.1]]) - origins
    return Rays(*map(drawn.array, (origins, aim / np.linalg.norm(aim, axis=1, keepdims=True), np.full(4, 0.01))))


def surface_of(t: tuple[float, float], ray: tuple[int, int]) -> Surface:
    return Surface(drawn.array(ray, np.int32), drawn.array(t), drawn.array([1.0, 1.0]), drawn.array([0.1, 0.1]))


@pytest.fixture(scope="module")
def surface() -> Surface:
    """Of the third ray and the first."""
    return surface_of((1.9, 1.8), (2, 0))


MATERIAL = jax.jit(lambda field, rays, surface: field(PLACE.of(rays, surface))[1])
SEEN = jax.jit(lambda field, material, towards, places: field.shade(material, towards, places=places).specular)


def test_it_looks_from_every_camera_at_every_point(field: Field, rays: Rays, surface: Surface) -> None:
    material = jax.tree.map(np.asarray, MATERIAL(field, rays, surface))
    origins, directions = np.asarray(rays.origins), np.asarray(rays.directions)
    places, towards = np.zeros((2, 4, 3), np.float32), np.zeros((2, 4, 3), np.float32)
    for point in range(2):
        ray = int(surface.ray[point])
        places[point] = origins[ray] + directions[ray] * np.asarray(surface.t)[point]
        for camera in range(4):
            direction = places[point, camera] - origins[camera]
            direction = direction / np.linalg.norm(direction)
            towards[point, camera] = direction * (-1 if direction @ material.normals_pred[:, point] > 0 else 1)
    repeated = jax.tree.map(lambda a: np.repeat(a, 4, 1), material)
    seen = SEEN(field, repeated, towards.reshape(8, 3).T, places.reshape(8, 3).T)
    seen = np.asarray(seen).T.reshape(2, 4, 3)
    assert np.ptp(seen, axis=1).max() > 0.01, "the premise: sides differ"
    expected = jax.jit(regularisers.metal_or_not)(material.diffuse.T, seen)
    found = jax.jit(lambda field: bias_for_two_kinds(field, PLACE, rays, surface))(field)
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_directions_go_into_the_surface(rays: Rays, surface: Surface) -> None:
    normals = np.float32([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0]])
    towards = jax.jit(lambda n: towards_surface(PLACE.of(rays, surface).points, rays.origins, n))(normals)
    np.testing.assert_allclose(np.linalg.norm(towards, axis=-1), 1, rtol=1e-6)
    assert (np.einsum("ncx,xn->nc", towards, normals) <= 0).all()


def test_an_object_among_surroundings_waits_for_its_reflections(rays: Rays) -> None:
    """One point in the object's ball, one outside it."""
    points = surface_of((1.9, 0.5), (0, 1))
    among = jax.jit(lambda factor: at_object(Place(BALL), rays, points, factor))
    np.testing.assert_array_equal(among(np.float32(0.25)), [0.25, 1])
    np.testing.assert_array_equal(among(np.float32(1.0)), [1, 1])


def test_what_an_object_stands_on_is_not_in_its_box(rays: Rays) -> None:
    """Points of which the second is on the border of a box, where a table may reach in."""
    points = surface_of((1.9, 0.5), (0, 0))
    places = np.abs(np.asarray(PLACE.of(rays, points).points)).max(0)
    inside = jax.jit(lambda points, half_box: Place(BALL).in_box(rays, points, half_box))
    assert inside(points, None).tolist() == [True, True]
    near, far = places.argmin(), places.argmax()
    found = inside(points, np.full(3, places[far] / 0.99, np.float32))
    assert found[near] and not found[far]


@pytest.mark.parametrize("place", [PLACE, Place(BALL)])
def test_neither_shape_nor_light_has_a_gradient(field: Field, rays: Rays, surface: Surface, place: Place) -> None:
    """Of the spatial network's last layer only diffuse colour and tint feel it; the features before, and the light, nothing."""
    total = lambda field: jnp.sum(bias_for_two_kinds(field, place, rays, surface))  # noqa: E731
    gradient = jax.tree.map(np.asarray, jax.jit(jax.grad(total))(field))
    held = (gradient.appearance, gradient.encoding, gradient.spatial.weights[:-1], gradient.spatial.biases[:-1])
    assert all((leaf == 0).all() for leaf in jax.tree.leaves(held))
    last = gradient.spatial.weights[-1]  # outputs first: density, diffuse (3), tint (3), roughness, normal (3), bottleneck
    outputs = np.abs(np.asarray(last)).max(axis=1)
    assert (outputs[1:7] > 0).any() and (outputs[0] == 0).all() and (outputs[7:] == 0).all()
