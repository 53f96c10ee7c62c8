import numpy as np
import pytest

from koala3d.capture.model import kinematics
from koala3d.capture.model.shapes.geometry import Box
from koala3d.capture.planning import Obstacles
from koala3d.capture.sessions.calibrate import candidates
from koala3d.datasets import pose

BOARD = pose.from_rotation_vector([np.pi, 0.0, 0.0], [0.265, 0.105, 0.003])


@pytest.fixture(scope="module")
def drawn(trajectory):
    from koala3d.capture.model.rig import RigDescription

    carrier = RigDescription().carrier()
    reach = candidates.reach_of(trajectory, carrier, BOARD)
    return reach, candidates.draw(trajectory, reach, BOARD, 0, 60), carrier


def test_the_arm_can_take_every_candidate(drawn):
    reach, found, _ = drawn
    assert len(found) == 60
    for one in found:
        np.testing.assert_allclose(
            kinematics.forward(one.joints), np.broadcast_to(one.base_from_flange, (len(one.joints), 4, 4)), atol=1e-6
        )
        assert (reach.obstacles.margin(one.joints) >= 0).all()


def test_candidates_see_the_board_from_where_the_trajectory_goes(drawn, trajectory):
    reach, found, carrier = drawn
    cameras = np.stack([one.base_from_flange @ carrier.flange_from_camera for one in found])
    places = cameras[:, :3, 3]
    assert (places >= reach.low - 1e-9).all() and (places <= reach.high + 1e-9).all()
    views = np.stack([view.camera_pose(carrier)[:3, 3] for view in trajectory.viewpoints()])
    assert (places >= views.min(0) - candidates.ROOM_M - 1e-9).all() and (places <= views.max(0) + candidates.ROOM_M + 1e-9).all()
    in_board = pose.inverse(BOARD) @ cameras
    tilt = np.arccos(in_board[:, 2, 2])
    assert tilt.max() <= candidates.MAX_TILT_RAD and np.degrees(np.ptp(tilt)) > 30
    aim = in_board[:, :3, 3] - in_board[:, 2:3, 3] / in_board[:, 2:3, 2] * in_board[:, :3, 2]  # where the axis meets the board
    assert (np.abs(aim[:, :2] - [0.135, 0.105]) <= candidates.AIM * np.array([0.27, 0.21]) + 1e-9).all()


def test_the_same_seed_draws_the_same(drawn, trajectory):
    reach, found, _ = drawn
    again = candidates.draw(trajectory, reach, BOARD, 0, 10)
    other = candidates.draw(trajectory, reach, BOARD, 1, 10)
    np.testing.assert_array_equal(again[9].joints, found[9].joints)
    assert not np.allclose(other[0].base_from_flange, found[0].base_from_flange)


def test_the_workspace_bounds_the_candidates(drawn, trajectory):
    _, _, carrier = drawn
    low, high = np.array([[0.1, 0.0, 0.0], [0.7, 0.3, 0.5]])  # half of what the trajectory takes up
    room = Box(centre=tuple((low + high) / 2), size=tuple(high - low))
    narrow = trajectory.model_copy(update={"safety": trajectory.safety.model_copy(update={"workspace": room})})
    reach = candidates.reach_of(narrow, carrier, BOARD)
    found = candidates.draw(narrow, reach, BOARD, 0, 20)
    assert found
    for one in found:
        assert (Obstacles.of(narrow, carrier).margin(one.joints) >= 0).all()


def test_looking_views_are_the_trajectorys_own(trajectory, carrier):
    home = np.radians([0.0, -90.0, 90.0, -90.0, -90.0, 0.0])
    found = candidates.looking(trajectory, carrier, home, 8)
    assert len(found) == 8
    own = np.stack([view.camera_pose(carrier) for view in trajectory.viewpoints()])
    for joints in found:
        camera = carrier.base_from_camera(joints)
        assert np.linalg.norm(own[:, :3, 3] - camera[:3, 3], axis=1).min() < 1e-6
