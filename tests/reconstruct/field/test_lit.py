"""Points and directions in the lamps' frame, against rotations by SciPy."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.scene.light import STILL, Frame, LightFrame
from koala3d.reconstruct.scene.rays import Rays
from tests import drawn

RNG = np.random.default_rng(0)
F32 = 2e-6  # a few roundings of float32
TOWARDS = jax.jit(Lit.towards, static_argnums=0)


def unit(count: int) -> np.ndarray:
    values = RNG.normal(size=(count, 3))
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def some_rays(count: int = 5) -> Rays:
    rotation = Rotation.random(count, rng=np.random.default_rng(1)).as_matrix()
    directions = np.concatenate([RNG.uniform(-0.3, 0.3, (count, 2)), np.ones((count, 1))], -1)
    world = np.einsum("nij,nj->ni", rotation.transpose(0, 2, 1), directions)
    f = drawn.array
    return Rays(f(unit(count)), f(world), f(np.full(count, 1e-3)), light=f(rotation))


@jax.jit
def on(rays: Rays, t: jax.Array, ray: jax.Array | None = None) -> Lit | None:
    return Lit.on(rays, t, ray)


def test_places_are_those_in_the_camera() -> None:
    rays, ray = some_rays(), np.int32([3, 0, 3])
    light = on(rays, t := np.float32([2.0, 1.0, 0.5]), ray)
    assert light is not None
    places = np.asarray(light.places)
    np.testing.assert_allclose(places[2], t, rtol=F32)  # depth: directions have z = 1 in the camera
    for column in range(3):
        expected = np.asarray(rays.light)[ray[column]] @ (np.asarray(rays.directions)[ray[column]] * t[column])
        np.testing.assert_allclose(places[:, column], expected, atol=F32)
    assert on(Rays(rays.origins, rays.directions, rays.radii), np.ones(5, np.float32)) is None


def test_about_the_lens_each_point_is_straight_ahead_by_the_shortest_turn() -> None:
    rays = some_rays()
    light = on(rays, np.full(5, 2.0, np.float32))
    assert light is not None
    turned = jax.jit(lambda light, directions: light.turned_about_lens(directions))
    np.testing.assert_allclose(turned(light, np.asarray(jax.jit(lambda r: r.viewdirs)(rays)).T), np.eye(3)[:, [2] * 5], atol=F32)
    directions = unit(5)
    found = np.asarray(turned(light, np.float32(directions.T))).T
    for index in range(5):
        place = np.asarray(light.places, np.float64)[:, index]
        place /= np.linalg.norm(place)
        across = np.cross(place, [0, 0, 1.0])
        turn = Rotation.from_rotvec(across / np.linalg.norm(across) * np.arccos(place[2]))
        expected = turn.apply(np.asarray(light.rotation)[index] @ directions[index])
        np.testing.assert_allclose(found[index], expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["camera", "turntable"])
def test_a_camera_that_looks_at_a_point_is_upright_in_its_lamps_frame(kind: Frame) -> None:
    frame = LightFrame(kind, distance=1.7)
    viewdirs = unit(6)
    light = TOWARDS(frame, np.float32(viewdirs.T))
    assert light is not None
    expected = frame.from_scene(np.stack([pose.look_at(-d, (0, 0, 0))[:3, :3] for d in viewdirs]))
    assert expected is not None
    np.testing.assert_allclose(light.rotation, expected, atol=5e-5)  # the axis is tilted by 1e-6, against a zero across it
    np.testing.assert_allclose(np.linalg.norm(light.places, axis=0), 1.7, rtol=1e-5)


def test_looking_along_the_axis_is_finite() -> None:
    for kind in ("camera", "turntable"):
        light = TOWARDS(LightFrame(kind), np.float32([[0.0, 0.0], [0.0, 0.0], [1.0, -1.0]]))
        assert light is not None
        np.testing.assert_allclose(np.abs(np.linalg.det(np.asarray(light.rotation))), 1, atol=1e-5)
    assert Lit.towards(STILL, drawn.array(np.zeros((3, 2)))) is None


def test_repeated_points_stay_beside_their_rotations() -> None:
    light = on(some_rays(), np.ones(5, np.float32))
    assert light is not None
    twice = jax.tree.map(np.asarray, jax.jit(lambda light: light.repeated(2))(light))
    np.testing.assert_array_equal(twice.places[:, 1], np.asarray(light.places)[:, 0])
    np.testing.assert_array_equal(twice.rotation[2], np.asarray(light.rotation)[1])
