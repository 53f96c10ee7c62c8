"""Distances against brute force, and configurations whose trouble is known."""

import numpy as np
import pytest

from koala3d.capture.model.kinematics import forward
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.shapes.distances import box_distance, segment_distance, sight_distance
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning.obstacles import Obstacles

MOUNT = RigDescription().carrier()
BOX = np.array([[0.3, -0.1, 0.0], [0.5, 0.1, 0.3]])
UPRIGHT = np.array([0, -np.pi / 2, 0, -np.pi / 2, 0, 0])


def _points(ends, count=400):
    share = np.linspace(0, 1, count)[:, None]
    return ends[0] * (1 - share) + ends[1] * share


def test_box_distance_equals_brute_force():
    rng = np.random.default_rng(0)
    for ends in rng.uniform(-1, 1, (50, 2, 3)):
        outside = np.maximum(np.maximum(BOX[0] - _points(ends), _points(ends) - BOX[1]), 0)
        assert box_distance(ends, BOX) == pytest.approx(np.linalg.norm(outside, axis=1).min(), abs=0.01)  # 0.4% of up to 2.4 m


def test_segment_distance_equals_brute_force():
    rng = np.random.default_rng(1)
    for first, second in rng.uniform(-1, 1, (50, 2, 2, 3)):
        slow = np.linalg.norm(_points(first)[:, None] - _points(second)[None], axis=-1).min()
        assert segment_distance(first, second) == pytest.approx(slow, abs=0.005)  # the samples are up to 8 mm apart


def test_sight_distance_equals_brute_force():
    rng = np.random.default_rng(2)
    for ends, eye in zip(rng.uniform(-1, 1, (50, 2, 3)), rng.uniform(-1, 1, (50, 3)), strict=True):
        share = np.linspace(0, 1, 400)[:, None, None]
        boxes = (1 - share) * eye + share * BOX  # (400, 2, 3)
        outside = np.maximum(np.maximum(boxes[:, :1] - _points(ends), _points(ends) - boxes[:, 1:]), 0)
        slow = np.linalg.norm(outside, axis=-1).min()
        assert sight_distance(ends, eye, BOX) == pytest.approx(slow, abs=0.02)  # 0.4 % of up to 2.4 m, along both


def test_parallel_and_pointlike_segments():
    line = np.array([[0, 0, 0], [1.0, 0, 0]])
    assert segment_distance(line, np.add(line, [0, 0.3, 0])) == pytest.approx(0.3)
    assert segment_distance(line, np.array([[2.0, 0, 0], [2.0, 0, 0]])) == pytest.approx(1.0)


def test_segments_end_at_flange_and_camera():
    joints = np.array([0.3, -1.2, 1.5, -0.4, -1.5, 0.2])
    carrier = MOUNT
    bracket = carrier.segments(joints)[carrier.shape.index["bracket"]]
    np.testing.assert_allclose(bracket, [forward(joints)[:3, 3], (forward(joints) @ MOUNT.flange_from_camera)[:3, 3]])


def test_upright_is_free_and_stretched_forward_hits_the_table():
    obstacles = Obstacles(MOUNT, 0.02, table_z=0.0, object_corners=BOX)
    assert obstacles.margin(UPRIGHT[None])[0] > 0
    pair, room = obstacles.nearest([0, 0.3, 0, -np.pi / 2, 0, 0])
    assert pair.endswith("to table") and room < 0


def test_an_arm_that_hangs_keeps_between_ceiling_and_table():
    """Upright is towards its table; what would lie on the table of a standing arm is in the ceiling."""
    hanging = Obstacles(MOUNT, 0.02, table_z=1.2, ceiling_z=0.0, up=-1)
    assert hanging.margin(UPRIGHT[None])[0] > 0
    pair, room = hanging.nearest([0, 0.3, 0, -np.pi / 2, 0, 0])
    assert pair.endswith("to ceiling") and room < 0
    standing = Obstacles(MOUNT, 0.02, table_z=0.0).nearest([0, 0.3, 0, -np.pi / 2, 0, 0])
    assert (standing[0].removesuffix("table"), standing[1]) == (pair.removesuffix("ceiling"), room)
    pair, room = Obstacles(MOUNT, 0.02, table_z=1.0, ceiling_z=0.0, up=-1).nearest(UPRIGHT)
    assert pair.endswith("to table") and room < 0


def test_folded_arm_hits_itself():
    pair, room = Obstacles(MOUNT, 0.02).nearest([0, -np.pi / 2, 2.9, -np.pi / 2, 0.3, 0])
    assert "table" not in pair and room < 0


def test_an_arm_between_camera_and_object_hides_it():
    behind_the_base = np.array([0, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, 0])  # the camera is at x = -0.4
    before = Obstacles(MOUNT, 0.02, object_corners=BOX)
    assert before.sight(behind_the_base[None])[0] < 0 and before.hiding(behind_the_base) == "base"
    below = Obstacles(MOUNT, 0.02, object_corners=BOX - [0.8, 0, 0])
    assert below.sight(behind_the_base[None])[0] > 0
    assert Obstacles(MOUNT, 0.02).sight(behind_the_base[None]) == np.inf


def test_workspace_holds_the_camera():
    corners = np.array([[-0.1, -0.1, 0], [0.1, 0.1, 0.5]])
    pair, room = Obstacles(MOUNT, 0.0, workspace_corners=corners).nearest(UPRIGHT)
    assert pair == "camera to the edge of the workspace" and room < -0.4


def test_every_pair_that_could_meet_is_checked_and_named():
    obstacles = Obstacles(MOUNT, 0.02, table_z=0.0, object_corners=BOX, workspace_corners=BOX, ceiling_z=2.0)
    names = list(obstacles.margins(UPRIGHT[None]))
    assert len(names) == len(set(names)) == 10 + 10 + 11 + 38 + 1  # table, ceiling, object, the arm itself, workspace
    assert "base to table" not in names and "shoulder to table" not in names, "they always touch or nearly so"
    assert {"forearm to base", "camera to upper arm", "shoulder to object", "camera to ceiling"} < set(names)
    assert "camera to bracket" not in names and "forearm to elbow" not in names


def test_a_larger_clearance_leaves_less_room_everywhere():
    joints = np.random.default_rng(3).uniform(-2, 2, (5, 6))
    near, far = (Obstacles(MOUNT, clearance, table_z=0.0, object_corners=BOX) for clearance in (0.0, 0.05))
    for name, room in near.margins(joints).items():
        np.testing.assert_allclose(far.margins(joints)[name], room - 0.05)
    np.testing.assert_array_equal(near.margin(joints), np.min(list(near.margins(joints).values()), axis=0))


def test_sight_does_not_depend_on_the_clearance_and_names_each_part_of_the_arm():
    joints = np.random.default_rng(4).uniform(-2, 2, (5, 6))
    near, far = (Obstacles(MOUNT, clearance, object_corners=BOX).sights(joints) for clearance in (0.0, 0.05))
    assert list(near) == [part.name for part in MOUNT.arm.parts]  # the camera is in front of its bracket
    for name, room in near.items():
        np.testing.assert_array_equal(far[name], room)


def test_the_obstacles_of_a_trajectory_are_those_of_its_file():
    trajectory = load_trajectory("koala_hanging", overrides=["safety.clearance_m=0.03"])
    obstacles = Obstacles.of(trajectory, MOUNT)
    assert (obstacles.table_z, obstacles.ceiling_z, obstacles.up, obstacles.clearance_m) == (1.1, -0.3, -1, 0.03)
    assert trajectory.object is not None and obstacles.object_corners is not None and obstacles.workspace_corners is None
    np.testing.assert_array_equal(obstacles.object_corners, trajectory.object.corners)
