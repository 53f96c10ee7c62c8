"""What `calib bench --coverage` counts and writes."""

import json

import numpy as np
import pytest

from koala3d.calib.handeye import repeating
from koala3d.calib.study import coverage
from koala3d.calib.study.coverage import Condition, Outcome
from koala3d.calib.study.rehearsal import draw_rig
from koala3d.datasets import kinematics, pose
from koala3d.datasets.calibration import UncertainPose
from koala3d.datasets.kinematics import UR5E


def outcome(distances):
    rigs = len(distances)
    return Outcome(Condition(1.0, separate=True), np.full((rigs, 2), 0.3), np.full((rigs, 2), 0.4), np.array(distances), 1)


def test_a_pose_is_covered_below_the_95_percent_point():
    found = outcome([[12.5, 13.0], [12.7, 1.0], [1.0, 2.0], [3.0, 4.0]])  # the point is 12.59
    assert found.coverage == (0.75, 0.75)


def test_distance_is_in_units_of_the_covariance():
    truth = pose.from_rotation_vector([0.1, 0.2, -0.3], [0.4, 0.5, 0.6])
    twist = np.array([1e-3, 0.0, 0.0, 0.0, 0.0, -2e-3])
    stated = pose.inverse(pose.from_rotation_vector(twist[3:], twist[:3])) @ truth
    assert coverage.squared_distance(UncertainPose(stated, np.diag([1e-6] * 6)), truth) == pytest.approx(5.0)


def test_table_and_numbers_are_written(tmp_path):
    coverage.write(tmp_path / "out", [outcome([[1.0, 20.0], [2.0, 3.0]])])
    table = (tmp_path / "out" / "coverage.md").read_text()
    assert "| 0.5 mm, 0.05° | of another session | recorded | 25 | 2 | 100% | 50% | 0.300 mm, 0.3000° |" in table
    [one] = json.loads((tmp_path / "out" / "coverage.json").read_text())["conditions"]
    assert one["covered"] == 1.0 and one["board_covered"] == 0.5 and one["failures"] == 1


def test_the_arm_is_off_by_what_its_links_are():
    """Reported and true poses of a session differ as those of the two arms do, beside the error of each stop."""
    rig, links = draw_rig(0), UR5E.calibrated(np.random.default_rng(1), repeating.LENGTH_M, repeating.ANGLE_RAD)
    session = coverage.drawn(np.random.default_rng(2), rig, links, 6)
    built = kinematics.forward(session.joints, links)
    apart, _ = pose.difference(built, session.base_from_flange)
    assert 2e-4 < np.median(apart) < 1e-2
    for flange, observation in zip(built, session.observations, strict=True):
        board = pose.inverse(flange @ rig.flange_from_camera) @ rig.base_from_board
        off = observation.pixels - rig.camera.project(observation.points @ board[:3, :3].T + board[:3, 3])
        assert np.sqrt((off**2).mean()) < 1.0  # a stop of 0.03 mm and corners; links as reported would be several pixels off
