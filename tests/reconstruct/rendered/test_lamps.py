"""Near lamps against sums over their light, and lamps that move against scenes that are turned as a whole."""

import jax.numpy as jnp
import numpy as np

from koala3d.reconstruct.rendered.lamps import Ring, arriving
from koala3d.reconstruct.rendered.light import Light
from koala3d.reconstruct.rendered.solids import ball
from koala3d.reconstruct.rendered.stages import STAGES, TESTED_DEG, TRAINED_DEG, carried, rings, turning
from koala3d.reconstruct.rendered.tracer import Body, Material, Tracer

SILVER = Material((0.2, 0.1, 0.1), (0.9, 0.9, 0.9), 300.0)


def test_a_near_lamp_is_in_its_direction_and_falls_off_with_the_squared_distance() -> None:
    one = Ring(np.array([[0.0, 0, 0]], np.float32), 40.0, np.ones((1, 3), np.float32), np.zeros(3, np.float32))
    places = np.array([[0.0, 0, 2], [0, 0, 4], [3, 0, 4]], np.float32).T
    towards = -places / np.linalg.norm(places, axis=0)
    sharp = np.asarray(one.convolved(jnp.asarray(towards), 1e9, jnp.asarray(places)))
    np.testing.assert_allclose(sharp, 1, rtol=1e-4)  # a lamp is as bright from afar
    matte = np.asarray(one.convolved(jnp.asarray(towards), 2.0, jnp.asarray(places)))[0]
    # wide lobes see its light, which falls with the square of the distances 2, 4 and 5; the lobes' blur adds a hundredth
    np.testing.assert_allclose(matte[1:] / matte[0], [1 / 4, 4 / 25], rtol=0.02)
    assert (np.asarray(one.convolved(jnp.asarray(-towards), 300.0, jnp.asarray(places))) < 1e-6).all()


def test_lamps_in_another_frame_are_asked_in_its_axes() -> None:
    light = Light.studio(1)
    matrix = turning(np.array([[1, 0, 0, 0.0], [0, 1, 0, 3.0], [0, 0, 1, 0.5], [0, 0, 0, 1]]))
    stand = jnp.asarray(np.tile(matrix[:3].reshape(12, 1), (1, 2)), jnp.float32)
    directions = jnp.array([[0.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    found = arriving(light, stand, jnp.zeros((3, 2)), directions, 50.0)
    # the camera is at +y: y of the object is x of the room, x of the object is -y
    expected = light.convolved(jnp.array([[1.0, 0.0], [0.0, -1.0], [0.0, 0.0]]), 50.0)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_ball_looks_alike_from_everywhere_under_lamps_that_go_along() -> None:
    tracer = Tracer((Body(ball(0.7), SILVER),), Ring.about_lens())
    shots = [pose for pose, _ in rings(6, 0, 0)][:3:2]
    pixels = np.stack([*np.meshgrid(np.linspace(-0.1, 0.1, 9), np.linspace(-0.1, 0.1, 9)), np.ones((9, 9))], -1).reshape(-1, 3)
    seen = []
    for pose in shots:
        rays = pixels / np.linalg.norm(pixels, axis=-1, keepdims=True) @ pose[:3, :3].T
        origins = np.broadcast_to(pose[:3, 3] / 0.12, rays.shape)
        lamps = carried(pose)
        lamps[:3, 3] /= 0.12
        seen.append(tracer.look(origins, rays, lamps))
    for name in ("diffuse", "specular"):
        # hits lie within 1e-5 of the surface; a lobe of concentration 300 turns that into a few ten-thousandths of its light
        np.testing.assert_allclose(seen[0][name], seen[1][name], atol=2e-3)
        assert np.ptp(seen[0][name]) > 0.05


def test_stages_have_the_views_that_are_asked_for() -> None:
    assert {"teapot", "teapot_room", "teapot_turntable", "teapot_ring_light", "gold_rings_turntable"} < set(STAGES)
    for name in ("teapot", "teapot_turntable"):
        shots = STAGES[name].shots(10, 4, 0)
        assert [split for _, split in shots].count("train") == 10 and len(shots) == 14
    heights = {split: {round(float(np.rad2deg(np.arcsin(p[2, 3] / 0.6)))) for p, s in rings(9, 4, 0) if s == split}
               for split in ("train", "test")}  # fmt: skip
    assert heights == {"train": set(TRAINED_DEG), "test": set(TESTED_DEG)}
    assert STAGES["teapot_room"].lamps_from_scene(rings(3, 0, 0)[0][0]) is None
