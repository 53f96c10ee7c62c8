"""Paths of several legs, lines of the tool, and motions that are steered: smooth, straight, and where they should be."""

import numpy as np
import pytest

from koala3d.capture.model.kinematics import UR5E, forward
from koala3d.capture.sim.controller.commands.joint_moves import joint_path
from koala3d.capture.sim.controller.commands.registers import ProgramError
from koala3d.capture.sim.controller.commands.tool_moves import tool_path
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.motions.followed import JointDrift, following
from koala3d.capture.sim.controller.motions.profiles import Move, Slowing
from koala3d.capture.sim.controller.motions.tool_paths import Drift
from koala3d.capture.sim.controller.motions.tracking import Tool, Tracked
from koala3d.datasets import pose

START = np.array([0.3, -1.4, 1.3, -1.5, -1.4, 0.2])
TOP = np.full(6, np.pi)


@pytest.fixture
def arm() -> SimulatedArm:
    return SimulatedArm(0, START, 0.0, 0.0)


def sampled(profile, duration: float | None = None, count: int = 4001) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    times = np.linspace(0, profile.duration if duration is None else duration, count)
    angles, speeds, _ = (np.array(part) for part in zip(*(profile.at(time) for time in times), strict=True))
    return times, angles, speeds


def smooth(times: np.ndarray, angles: np.ndarray, speeds: np.ndarray, acceleration: float) -> None:
    """Speeds are the slopes of the angles, and change no faster than they may."""
    step = times[1]
    np.testing.assert_allclose(np.diff(angles, axis=0) / step, (speeds[1:] + speeds[:-1]) / 2, atol=acceleration * step)
    assert np.abs(np.diff(speeds, axis=0)).max() <= acceleration * step * 1.01


@pytest.mark.parametrize("radius", [0.0, 0.002, 0.05, 10.0])
def test_a_joint_path_keeps_to_its_lines_outside_of_the_radius(arm: SimulatedArm, radius: float) -> None:
    points = START + np.array([[0.0] * 6, [0.4, 0, 0, 0, 0, 0], [0.4, 0.3, 0, 0, 0, 0]])
    path = joint_path(arm, points, [1.0, 0.5], [2.0, 1.5], [radius, 0.0])
    times, angles, speeds = sampled(path)
    smooth(times, angles, speeds, 3.5)  # both accelerations at most, where the legs add up
    np.testing.assert_array_equal(angles[[0, -1]], points[[0, -1]])
    off = np.minimum(np.abs(angles - points[0])[:, 1], np.abs(angles - points[1])[:, 0])  # from the two lines
    away = np.linalg.norm(forward(angles)[:, :3, 3] - forward(points[1])[:3, 3], axis=-1)
    nearest = away.min()
    assert off[away > radius].max(initial=0.0) < 1e-12
    assert nearest < 1e-4 if radius == 0 else 1e-5 < nearest < radius
    stopping = Move(points[0], points[1], 1.0, 2.0).duration + Move(points[1], points[2], 0.5, 1.5).duration
    assert path.duration == pytest.approx(stopping) if radius == 0 else path.duration < stopping


def test_a_blend_straight_ahead_keeps_the_speed(arm: SimulatedArm) -> None:
    points = START + np.array([[0.0] * 6, [0.5, 0, 0, 0, 0, 0], [1.0, 0, 0, 0, 0, 0]])
    path = joint_path(arm, points, [0.5, 0.5], [2.0, 2.0], [10.0, 0.0])
    whole = Move(points[0], points[2], 0.5, 2.0)
    assert path.duration == pytest.approx(whole.duration)
    np.testing.assert_allclose(sampled(path)[1], sampled(whole)[1], atol=1e-12)


def test_lines_of_the_tool_are_straight_and_the_joints_smooth(arm: SimulatedArm) -> None:
    arm.flange_from_tcp = pose.from_rotation_vector([0.1, 0.4, 0.0], [0.02, 0.0, 0.15])
    begin = arm.tool.place(START)
    corner = begin @ pose.from_rotation_vector([0.1, 0.0, 0.2], [0.0, 0.1, 0.05])
    end = corner @ pose.from_rotation_vector([0.0, -0.2, 0.0], [0.1, 0.0, 0.0])
    path, starts = tool_path(arm, START, np.stack([corner, end]), [0.25, 0.2], [1.2, 1.0], [0.02, 0.0])
    times, angles, speeds = sampled(path, count=2001)
    smooth(times, angles, speeds, 40.0)
    places = np.array([arm.tool.place(one) for one in angles])
    np.testing.assert_allclose(places[[0, -1]], np.stack([begin, end]), atol=1e-8)
    for first, last, part in ((begin, corner, times < starts[1]), (corner, end, times > starts[0] + 0.7)):
        along = last[:3, 3] - first[:3, 3]
        away = places[part, :3, 3] - first[:3, 3]
        off = np.linalg.norm(np.cross(away, along / np.linalg.norm(along)), axis=-1)
        far = np.linalg.norm(places[part, :3, 3] - corner[:3, 3], axis=-1) > 0.02
        assert off[far].max() < 2e-6  # what cubics between places 2 cm apart miss


def test_a_line_that_is_too_fast_for_a_joint_takes_longer(arm: SimulatedArm) -> None:
    end = arm.tool.place(START)
    end[:3, 3] += [0.2, -0.15, -0.25]
    slow, _ = tool_path(arm, START, end[None], [0.25], [1.2], [0.0])
    fast, _ = tool_path(arm, START, end[None], [3.0], [100.0], [0.0])
    assert fast.duration < slow.duration
    assert np.abs(sampled(fast)[2]).max() <= np.pi * 1.001 and np.abs(sampled(fast)[2]).max() > 3.0


def test_a_line_out_of_reach_is_refused(arm: SimulatedArm) -> None:
    end = arm.tool.place(START)
    end[:3, 3] *= 3
    with pytest.raises(ProgramError, match="out of reach or through a singularity"):
        tool_path(arm, START, end[None], [0.25], [1.2], [0.0])


def test_a_drift_of_the_tool_goes_on_and_turns_evenly() -> None:
    tool = Tool(UR5E, np.eye(4), TOP)
    wanted = np.array([0.02, -0.03, 0.01, 0.0, 0.0, 0.2])
    begin = tool.place(START)
    drift = Tracked(Drift(begin, np.zeros(6), wanted, 0.5), tool, START)
    assert np.isinf(drift.duration)
    for time in (0.25, 0.5, 2.0):
        moved = time**2 / 2 / 0.5 if time < 0.5 else time - 0.25
        place = tool.place(drift.at(time)[0])
        np.testing.assert_allclose(place[:3, 3] - begin[:3, 3], moved * wanted[:3], atol=1e-6)
        np.testing.assert_allclose(pose.rotation_vector(place[:3, :3] @ begin[:3, :3].T), moved * wanted[3:], atol=1e-5)
    rests = sampled(Slowing(drift, 2.0, 1.0, 0.4))
    smooth(*rests, 20.0)
    assert not rests[2][-1].any()
    np.testing.assert_allclose(tool.place(rests[1][-1])[:3, 3] - begin[:3, 3], (1.75 + 0.2) * wanted[:3], atol=1e-6)


def test_a_drift_into_a_singularity_ends_before_it() -> None:
    tool = Tool(UR5E, np.eye(4), TOP)
    drift = Tracked(Drift(tool.place(START), np.zeros(6), np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]), 0.1), tool, START)
    drift.at(10.0)
    assert 0.1 < drift.fault < 3.0 and np.isfinite(drift.at(50.0)[0]).all()


def test_a_target_that_moves_is_followed_late_by_the_delay() -> None:
    angles, speeds, step = START.copy(), np.zeros(6), 0.002
    for count in range(2000):
        target = START + count * step * 0.2
        angles, speeds, _ = following(angles, speeds, target, 0.1, TOP).at(step)
    np.testing.assert_allclose(target - angles, 0.2 * 0.1, rtol=0.03)
    np.testing.assert_allclose(speeds, 0.2, rtol=1e-3)


def test_a_target_far_away_is_not_reached_faster_than_the_joints_turn() -> None:
    profile = following(START, np.zeros(6), START + np.array([2.0, -1.0, 0, 0, 0, 0]), 0.03, TOP)
    times, angles, speeds = sampled(profile)
    assert 0.95 * np.pi < np.abs(speeds).max() <= np.pi * 1.001
    np.testing.assert_allclose(angles[-2], profile.target, atol=1e-6)
    np.testing.assert_allclose(np.gradient(angles, times, axis=0)[1:-1], speeds[1:-1], atol=1e-2)


def test_joints_drift_on_at_their_speeds() -> None:
    drift = JointDrift(START, np.zeros(6), np.array([0.2, 0, -0.1, 0, 0, 0]), 0.4)
    times, angles, speeds = sampled(drift, 2.0)
    smooth(times, angles, speeds, 0.5)
    np.testing.assert_allclose(angles[-1] - START, [0.2 * 1.8, 0, -0.1 * 1.8, 0, 0, 0], atol=1e-12)
    assert np.isinf(drift.duration) and JointDrift(START, drift.last, np.zeros(6), 0.4).duration == 0.4
