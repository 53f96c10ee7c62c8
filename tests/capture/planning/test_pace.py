"""The limit of the body's speed, against dense forward kinematics over the motion of the simulated arm."""

import numpy as np
import pytest

from koala3d.capture.model.carrier import Beside, Carrier
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Motion, load_trajectory
from koala3d.capture.planning import Pace, fastest, plan
from koala3d.capture.planning.durations import duration
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.datasets import pose

CARRIER = RigDescription().carrier()
MOTION = Motion(speed=1.0, acceleration=1.4)


def surface(carrier: Carrier) -> list[tuple[int, np.ndarray]]:
    """Points on every part: link, (n, 3) in its frame."""
    rng, found = np.random.default_rng(0), []
    for part in carrier.shape.parts:
        around = rng.normal(size=(60, 3))
        around *= part.radius / np.linalg.norm(around, axis=1, keepdims=True)
        found.append((part.link, np.concatenate([part.start + around, part.end + around])))
    return found


def measured(start: np.ndarray, goal: np.ndarray, pace: Pace, carrier: Carrier) -> float:
    """Speed of the fastest of many points on the body [m/s], while the simulated arm makes the move."""
    arm = SimulatedArm(0, start, 0.0, 0.0)
    arm.move_to(goal, pace.speed, pace.acceleration, 0.0)
    period, highest = 2e-3, 0.0
    times = np.arange(0.0, arm.profile.duration, period)
    frames = carrier.frames(np.stack([arm.target(now)[0] for now in times]))
    for link, points in surface(carrier):
        places = np.einsum("tij,nj->tni", frames[:, link, :3, :3], points) + frames[:, None, link, :3, 3]
        highest = max(highest, float(np.linalg.norm(np.diff(places, axis=0), axis=-1).max()) / period)
    return highest


@pytest.mark.parametrize("seed", range(4))
def test_no_point_of_the_body_is_faster_than_the_limit_and_long_moves_reach_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = rng.uniform(-2, 2, 6)
    for size in (0.1, 1.5):
        goal = start + rng.uniform(-size, size, 6)
        pace = Pace.of(start, goal, MOTION, CARRIER)
        found = measured(start, goal, pace, CARRIER)
        assert found <= 0.25 + 1e-6 and found <= pace.point_speed + 1e-6
        assert found > (0.9 if size > 1 else 0.75) * pace.point_speed  # points are drawn, and it may be the fastest in a ramp


def test_a_move_of_the_wrist_is_as_fast_as_the_trajectory_says() -> None:
    """The limit only binds if a point is far from the axis."""
    start = np.radians([0, -90, 90, -90, -90, 0.0])
    assert Pace.of(start, start + np.eye(6)[5], MOTION, CARRIER).speed == 1.0
    swing = Pace.of(start, start + np.eye(6)[0], MOTION, CARRIER)
    assert swing.speed * swing.lever == pytest.approx(0.25) and swing.speed < 0.5 and swing.seconds > 2
    still = Pace.of(start, start, MOTION, CARRIER)
    assert still.seconds == 0 and still.point_speed == 0


def test_factor_and_limit_of_the_fastest_joint_apply_after_the_limit_of_the_body() -> None:
    start = np.radians([0, -90, 90, -90, -90, 0.0])
    goal = start + np.eye(6)[0]
    full, slow = Pace.of(start, goal, MOTION, CARRIER), Pace.of(start, goal, MOTION, CARRIER, slow=0.1)
    assert slow.speed == pytest.approx(0.1 * full.speed) and slow.acceleration == pytest.approx(0.14)
    assert Pace.of(start, goal, MOTION, CARRIER, limit=0.1).speed == 0.1


def test_a_plate_on_the_flange_counts() -> None:
    start = np.radians([0, -90, 90, -90, -90, 0.0])
    wide = Carrier(
        CARRIER.arm, CARRIER.flange_from_camera, beside=Beside(np.eye(4), pose.rigid(np.eye(3), [0, 0, 0.02]), (0.6, 0.4))
    )
    turn = Pace.of(start, start + np.eye(6)[5], MOTION, wide)
    assert turn.lever == pytest.approx(np.hypot(0.3, 0.2), abs=0.03) and turn.speed < 1.0


def test_a_session_keeps_the_limit_of_its_rig() -> None:
    trajectory = load_trajectory("koala_turntable")
    rigs = [
        RigDescription.model_validate(
            {"robot": {"max_tool_speed": speed}, "turntable": {"base_from_turntable": {"position": [0.4, 0, 0]}}}
        ).carrier()
        for speed in (0.05, 3.0)
    ]
    slow, free = (fastest(trajectory, plan(trajectory, rig), rig) for rig in rigs)
    assert slow == pytest.approx(0.05, rel=1e-6) and 0.05 < free < 3
    times = [duration(trajectory, plan(trajectory, rig), rig) for rig in rigs]
    assert times[0] > times[1] + 3
