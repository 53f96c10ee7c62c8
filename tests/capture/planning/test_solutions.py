"""Every solution takes its view; a view without one says why."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.capture.model import kinematics
from koala3d.capture.model.kinematics import JOINT_LIMIT, forward
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.viewpoints import Viewpoint
from koala3d.capture.planning.obstacles import Obstacles
from koala3d.capture.planning.solutions import MIN_SINGULARITY, solve
from koala3d.datasets import pose

MOUNT = RigDescription().carrier()
FREE = Obstacles(replace(MOUNT, cable=None), 0.02, table_z=0.0)
TARGET = (0.4, 0.0, 0.14)


def view(position: tuple[float, float, float], rolls: tuple[float, ...] = (0.0,)) -> Viewpoint:
    return Viewpoint(pose.look_at(position, TARGET), rolls, name="000")


def test_every_solution_reaches_the_pose_of_its_roll() -> None:
    wanted = view((0.15, 0.1, 0.5), (0.0, np.pi / 2, np.pi))
    found = solve(wanted, FREE)
    assert not found.reason and len(found.joints) == len(found.rolls) > 8 and set(found.rolls) == {0, 2}  # roll 1 is too close
    for index, joints in enumerate(found.joints):
        taken = found.taken_by(index, MOUNT)
        np.testing.assert_allclose(forward(joints) @ MOUNT.flange_from_camera, taken.camera_pose(MOUNT), atol=1e-5)
        assert taken.rolls == (0.0,) and taken.name == "000"


def test_every_solution_can_be_used() -> None:
    found = solve(view((0.15, 0.1, 0.5), (0.0, np.pi / 2)), FREE)
    assert (FREE.margin(found.joints) >= 0).all() and (np.abs(found.joints) <= JOINT_LIMIT).all()
    assert min(kinematics.singularity(joints) for joints in found.joints) >= MIN_SINGULARITY


def test_turned_joints_are_offered_only_within_their_limits() -> None:
    found = solve(view((0.15, 0.1, 0.5)), FREE)
    base, last = found.joints[:, 0], found.joints[:, 5]
    assert np.ptp(base) > np.pi and np.ptp(last) > np.pi, "the premise: some are a whole turn apart"
    once = {tuple(np.round(kinematics.nearest_turn(joints, FREE.carrier.arm.home), 6)) for joints in found.joints}
    assert len(once) < len(found.joints) == len({tuple(np.round(joints, 6)) for joints in found.joints})


@pytest.mark.parametrize(
    ("wanted", "obstacles", "words"),
    [
        (view((1.5, 0.0, 0.5)), FREE, "out of reach, wrist"),
        (Viewpoint(pose.look_at((0.0, 0.0, 0.3), (0.0, 0.001, 0.0))), FREE, "close"),
        (view((0.4, 0.05, 0.03)), FREE, "to table too close"),
        (Viewpoint(joints=np.array([0, -1.5, 1.5, -1.5, -1.5, 7.0])), FREE, "joint 6 at 401 degrees, limit 360"),
        (Viewpoint(joints=np.array([0, 0.3, 0, -1.5, 0, 0])), FREE, "to table too close"),
    ],
)
def test_a_view_that_cannot_be_taken_says_why(wanted: Viewpoint, obstacles: Obstacles, words: str) -> None:
    assert words in solve(wanted, obstacles).reason


def test_given_joint_angles_are_kept_and_get_their_camera_pose() -> None:
    joints = np.radians([0, -90, 90, -90, -90, 0.0])
    found = solve(Viewpoint(joints=joints, name="007"), FREE)
    assert not found.reason and len(found.joints) == 1 and (found.joints[0] == joints).all()
    np.testing.assert_array_equal(found.taken_by(0, MOUNT).base_from_camera, forward(joints) @ MOUNT.flange_from_camera)


def test_solutions_that_hide_the_object_are_left_out() -> None:
    box = np.array([[0.3, -0.1, 0.0], [0.5, 0.1, 0.3]])
    seen = solve(view((0.05, 0.1, 0.5), (0.0, np.pi / 2, np.pi)), Obstacles(MOUNT, 0.02, table_z=0.0, object_corners=box))
    obstacles = Obstacles(MOUNT, 0.02, table_z=0.0, object_corners=box)
    assert not seen.reason and (obstacles.sight(seen.joints) >= 0).all()
