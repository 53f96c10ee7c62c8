"""The contract of the driver on a real arm: small moves around where it stands. Somebody holds the emergency stop.

KOALA_UR5E_HOST=192.168.0.10 .venv/bin/python -m pytest tests/hardware/test_ur5e.py -m hardware
"""

import os
import threading

import numpy as np
import pytest

from koala3d.capture.drivers.errors import MotionError, SafetyError
from koala3d.capture.drivers.ur.robot import UniversalRobot

pytestmark = pytest.mark.hardware
STEP = np.radians(2.0)


@pytest.fixture(params=["ur_rtde", "koala"])
def robot(request):
    if request.param == "ur_rtde":
        pytest.importorskip("rtde_control", reason="ur-rtde is not installed: it has no wheel for this Python and platform")
    host = os.environ.get("KOALA_UR5E_HOST")
    if not host:
        pytest.skip("no arm: KOALA_UR5E_HOST, the address of its controller, is not set")
    with UniversalRobot(host, client=request.param) as found:
        yield found


def test_small_moves_there_and_back(robot):
    start = robot.state().joints
    poses = []
    for joints in (start + STEP, start, start + STEP, start):
        robot.move_to(joints, speed=0.1, acceleration=0.5)
        state = robot.state()
        np.testing.assert_allclose(state.joints, joints, atol=1e-3)
        poses.append(state.base_from_flange)
    assert np.linalg.norm(poses[0][:3, 3] - poses[2][:3, 3]) < 1e-4  # repeatability by the data sheet: 0.03 mm
    assert np.linalg.norm(poses[1][:3, 3] - poses[3][:3, 3]) < 1e-4


def test_stop_from_another_thread(robot):
    start = robot.state().joints
    threading.Timer(0.5, robot.stop).start()
    with pytest.raises(MotionError, match="stopped on request"):
        robot.move_to(start + 5 * STEP, speed=0.05, acceleration=0.5)
    robot.clear_stop()
    robot.move_to(start, speed=0.1, acceleration=0.5)


def test_unsafe_targets_move_nothing(robot):
    start = robot.state().joints
    with pytest.raises(SafetyError):
        robot.move_to(start + STEP, speed=10.0, acceleration=0.5)
    np.testing.assert_allclose(robot.state().joints, start, atol=1e-4)
