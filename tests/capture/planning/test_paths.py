"""Ways around obstacles are free everywhere, also between the configurations that were looked at."""

import numpy as np
import pytest

from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.carrier import CameraCapsule, Carrier
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.shapes.solids import CylinderSolid
from koala3d.capture.planning.obstacles import Obstacles
from koala3d.capture.planning.paths import LEAVE, are_free, find_path, is_free, least_margin

MOUNT = RigDescription().carrier()
POST = np.array([[-0.65, -0.05, 0.0], [-0.45, 0.05, 0.6]])
"""Stands where the arm would sweep from one side to the other."""
OBSTACLES = Obstacles(MOUNT, 0.02, table_z=0.0, object_corners=POST)
LEFT = np.array([-0.9, -0.9, 1.3, -2.0, -1.57, 0.0])
RIGHT = np.array([0.9, -0.9, 1.3, -2.0, -1.57, 0.0])


def dense(start, goal, obstacles):
    """The smallest margin of 1001 configurations on a straight path [m]: the arm moves by about 1 mm between two of them."""
    return obstacles.margin(np.linspace(start, goal, 1001)).min()


@pytest.mark.parametrize("seed", range(3))
def test_a_margin_is_never_overstated(seed):
    """Table, object, clearance to itself and a mast, on paths on which all joints turn; none of them is refused without need."""
    mast = CylinderSolid(kind="cylinder", name="mast", radius=0.03, height=1.5, pose={"position": [0.3, 0.5, 0.75]})
    carrier = Carrier(load_arm("ur5e"), MOUNT.flange_from_camera, solids=(mast,))
    obstacles = Obstacles(carrier, 0.02, table_z=-0.4, object_corners=POST, workspace_corners=np.array([[-1.0] * 3, [1.0] * 3]))
    rng = np.random.default_rng(seed)
    starts = rng.uniform(-2, 2, (16, 6))
    goals = starts + rng.uniform(-0.7, 0.7, (16, 6))
    seen = 0
    for start, goal, free in zip(starts, goals, are_free(starts, goals, obstacles), strict=True):
        true = dense(start, goal, obstacles)
        found = least_margin(np.stack([start, goal]), obstacles)
        assert true - 1.6e-3 <= found <= true + 1e-12  # 1 mm, and half a step of the dense one
        if obstacles.margin(start[None])[0] >= 0:
            assert not free or true >= 0
            assert free or true < 1e-3  # twice what a piece is no longer divided for, and half a step
            seen += free
    assert seen > 1, "the premise: some are free"


def test_a_rod_does_not_jump_over_a_rod():
    """At both ends of a turn of joint 1 by 0.1 rad and in its middle nothing is near; between them two thin rods cross."""
    rod = CameraCapsule(name="rod", start=(0, 0, 0), end=(0, 0, 0.3), radius=0.002)
    joints = np.radians([0, -90, 90, -90, -90, 0])
    tip = Carrier(load_arm("ur5e"), MOUNT.flange_from_camera, body=(rod,)).base_from_camera(joints) @ [0, 0, 0.28, 1]
    pole = CylinderSolid(kind="cylinder", name="pole", radius=0.001, height=0.02, pose={"position": tuple(tip[:3])})
    obstacles = Obstacles(Carrier(load_arm("ur5e"), MOUNT.flange_from_camera, body=(rod,), solids=(pole,)), 0.0)
    start, goal = (joints + np.eye(6)[0] * turn for turn in (-0.025, 0.075))
    few, many = np.linspace(start, goal, 3), np.linspace(start, goal, 400)
    assert obstacles.margin(few).min() > 0.005 and obstacles.margin(many).min() < 0, "the premise"
    assert not is_free(start, goal, obstacles)


def test_an_arm_that_is_too_close_may_leave_but_not_come_closer():
    out = np.array([0.2, -0.9, 1.3, -2.0, -1.57, 0.0])
    turns = np.linspace(0, 0.6, 601)
    margins = OBSTACLES.margin(out + turns[:, None] * np.eye(6)[0])
    edge = turns[int(np.argmax(margins > 0))]
    start = out + (edge - 0.6 * LEAVE) * np.eye(6)[0]  # 30 % of the way that is allowed
    assert OBSTACLES.margin(start[None])[0] < 0, "the premise"
    assert is_free(start, out + 0.6 * np.eye(6)[0], OBSTACLES)
    assert not is_free(start - 2 * LEAVE * np.eye(6)[0], out + 0.6 * np.eye(6)[0], OBSTACLES), "deeper inside"


def test_a_goal_that_is_too_close_is_never_reached():
    """Everything around it is free, so that a tree could grow from it."""
    turns = np.linspace(0.9, 0, 4501)
    margins = OBSTACLES.margin(RIGHT + (turns - 0.9)[:, None] * np.eye(6)[0])
    touching = RIGHT + (turns[int(np.argmax(margins < -1e-5))] - 0.9) * np.eye(6)[0]
    assert -3e-4 < OBSTACLES.margin(touching[None])[0] < 0, "the premise"
    assert find_path(LEFT, touching, OBSTACLES) is None and find_path(RIGHT, touching, OBSTACLES) is None


def test_a_blocked_path_is_detected_and_avoided():
    assert OBSTACLES.margin(np.stack([LEFT, RIGHT])).min() > 0  # both ends are free
    assert not is_free(LEFT, RIGHT, OBSTACLES)  # and the straight path is not: the premise
    np.testing.assert_array_equal(are_free(np.stack([LEFT, LEFT]), np.stack([RIGHT, LEFT]), OBSTACLES), [False, True])
    path = find_path(LEFT, RIGHT, OBSTACLES)
    assert path is not None and (path[-1] == RIGHT).all() and len(path) > 1
    here = LEFT
    for there in path:
        assert dense(here, there, OBSTACLES) >= 0
        here = there


def test_the_search_is_repeatable():
    first, second = find_path(LEFT, RIGHT, OBSTACLES), find_path(LEFT, RIGHT, OBSTACLES)
    np.testing.assert_array_equal(first, second)


def test_no_path_into_an_obstacle():
    inside = np.array([0.0, -0.9, 1.3, -2.0, -1.57, 0.0])
    assert OBSTACLES.margin(inside[None])[0] < 0
    assert find_path(LEFT, inside, OBSTACLES, tries=20) is None


@pytest.mark.parametrize("goal", [LEFT, LEFT - [0.2, 0, 0, 0, 0.1, 0]])
def test_a_free_straight_path_is_taken(goal):
    path = find_path(LEFT, goal, OBSTACLES)
    assert path is not None and len(path) == 1 and (path[0] == goal).all()
