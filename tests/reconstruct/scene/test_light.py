"""Rotations into the lamps' frame, worked out by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.reconstruct.scene.light import STILL, LightFrame

TURNTABLE, RING = LightFrame("turntable"), LightFrame("camera")


def orientation(position: tuple[float, float, float]) -> np.ndarray:
    """Rotation of a camera that looks at the origin."""
    return pose.look_at(position, (0, 0, 0))[:3, :3]


def test_lamps_that_stand_still_need_no_rotation() -> None:
    assert STILL.from_scene(np.eye(3)) is None and not STILL.moves and not STILL.near


@pytest.mark.parametrize("height", [-0.5, 0.0, 3.0])
def test_a_camera_before_a_turntable_is_always_at_azimuth_zero(height: float) -> None:
    """From +y: what points to the camera is x in the room; the object's x is then 90 degrees clockwise of it: -y."""
    room_from_scene = TURNTABLE.from_scene(orientation((0.0, 2.0, height)))
    assert room_from_scene is not None
    np.testing.assert_allclose(room_from_scene @ [0, 1, 0], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(room_from_scene @ [1, 0, 0], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(room_from_scene @ [0, 0, 1], [0, 0, 1], atol=1e-12)


def test_the_camera_of_a_turntable_stands_still_in_the_room() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    first = orientation((1.0, 0.3, 0.5))
    turned = np.stack([Rotation.from_rotvec(angle * axis).as_matrix() @ first for angle in np.linspace(-3, 3, 7)])
    room_from_scene = LightFrame("turntable", (0.6, 0.0, 0.8)).from_scene(turned)
    assert room_from_scene is not None
    np.testing.assert_allclose(np.linalg.det(room_from_scene), 1, atol=1e-12)
    in_room = room_from_scene @ turned
    np.testing.assert_allclose(in_room, np.broadcast_to(in_room[0], in_room.shape), atol=1e-12)


def test_from_straight_above_the_bottom_of_the_picture_is_at_azimuth_zero() -> None:
    """x right, y down, z forward: this camera's picture has the scene's y at its bottom."""
    room_from_scene = TURNTABLE.from_scene(np.array([[-1.0, 0, 0], [0, 1, 0], [0, 0, -1]]))
    assert room_from_scene is not None
    np.testing.assert_allclose(room_from_scene @ [0, 1, 0], [1, 0, 0], atol=1e-9)


def test_lamps_on_the_camera_see_what_it_sees() -> None:
    """From +x, upright: forward (z) is -x, right (x) is +y, down (y) is -z."""
    camera_from_scene = RING.from_scene(orientation((2.0, 0.0, 0.0)))
    assert camera_from_scene is not None
    expected = [[0, 1, 0], [0, 0, -1], [-1, 0, 0]]
    np.testing.assert_allclose(camera_from_scene, expected, atol=1e-12)
