"""Points and directions in the lamps' frame, against rotations by SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets import pose
from reconstruct.field.lit import Lit
from reconstruct.scene.light import STILL, Frame, LightFrame
from reconstruct.scene.rays import Rays

RNG = np.random.default_rng(0)
F32 = 2e-6  # a few roundings of float32


def unit(count: int) -> np.ndarray:
    values = RNG.normal(size=(count, 3))
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def some_rays(count: int = 5) -> Rays:
    rotation = Rotation.random(count, rng=np.random.default_rng(1)).as_matrix()
    directions = np.concatenate([RNG.uniform(-0.3, 0.3, (count, 2)), np.ones((count, 1))], -1)
    world = np.einsum("nij,nj->ni", rotation.transpose(0, 2, 1), directions)
    f = lambda a: jnp.asarray(a, jnp.float32)  # noqa: E731
    return Rays(f(unit(count)), f(world), f(np.full(count, 1e-3)), light=f(rotation))


def test_places_are_those_in_the_camera() -> None:
    rays, ray = some_rays(), jnp.array([3, 0, 3])
    light = Lit.on(rays, t := jnp.array([2.0, 1.0, 0.5]), ray)
    assert light is not None
    np.testing.assert_allclose(light.places[2], t, rtol=F32)  # depth: directions have z = 1 in the camera
    for column in range(3):
        expected = np.asarray(rays.light)[ray[column]] @ (np.asarray(rays.directions)[ray[column]] * t[column])
        np.testing.assert_allclose(light.places[:, column], expected, atol=F32)
    assert Lit.on(Rays(rays.origins, rays.directions, rays.radii), jnp.ones(5)) is None


def test_about_the_lens_each_point_is_straight_ahead_by_the_shortest_turn() -> None:
    rays = some_rays()
    light = Lit.on(rays, jnp.full(5, 2.0))
    assert light is not None
    np.testing.assert_allclose(light.turned_about_lens(rays.viewdirs.T), np.eye(3)[:, [2] * 5], atol=F32)
    directions = unit(5)
    found = np.asarray(light.turned_about_lens(jnp.asarray(directions.T, jnp.float32))).T
    for index in range(5):
        place = np.asarray(light.places[:, index], np.float64)
        place /= np.linalg.norm(place)
        across = np.cross(place, [0, 0, 1.0])
        turn = Rotation.from_rotvec(across / np.linalg.norm(across) * np.arccos(place[2]))
        expected = turn.apply(np.asarray(light.rotation)[index] @ directions[index])
        np.testing.assert_allclose(found[index], expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["camera", "turntable"])
def test_a_camera_that_looks_at_a_point_is_upright_in_its_lamps_frame(kind: Frame) -> None:
    frame = LightFrame(kind, distance=1.7)
    viewdirs = unit(6)
    light = Lit.towards(frame, jnp.asarray(viewdirs.T, jnp.float32))
    assert light is not None
    expected = frame.from_scene(np.stack([pose.look_at(-d, (0, 0, 0))[:3, :3] for d in viewdirs]))
    assert expected is not None
    np.testing.assert_allclose(light.rotation, expected, atol=5e-5)  # the axis is tilted by 1e-6, against a zero across it
    np.testing.assert_allclose(jnp.linalg.norm(light.places, axis=0), 1.7, rtol=1e-5)


def test_looking_along_the_axis_is_finite() -> None:
    for kind in ("camera", "turntable"):
        light = Lit.towards(LightFrame(kind), jnp.array([[0.0, 0.0], [0.0, 0.0], [1.0, -1.0]]))
        assert light is not None
        np.testing.assert_allclose(np.abs(np.linalg.det(np.asarray(light.rotation))), 1, atol=1e-5)
    assert Lit.towards(STILL, jnp.zeros((3, 2))) is None


def test_repeated_points_stay_beside_their_rotations() -> None:
    light = Lit.on(some_rays(2), jnp.ones(2))
    assert light is not None
    twice = light.repeated(2)
    np.testing.assert_array_equal(twice.places[:, 1], light.places[:, 0])
    np.testing.assert_array_equal(twice.rotation[2], light.rotation[1])
