"""Freedrive through both clients: a person pushes the arm, and a stop holds it again."""

import numpy as np
import pytest

from koala3d.capture.drivers.errors import SimulationError
from koala3d.capture.sim.controller.process import SimulatedController
from tests.moments import until

pytestmark = pytest.mark.both_clients
STEP = np.array([0.05, 0.02, -0.02, 0.03, 0.0, 0.05])


@pytest.fixture
def simulated():
    with SimulatedController.start(seed=3, time_scale=4.0) as found:
        yield found


def push(simulated, robot):
    goal = robot.state().joints + STEP
    simulated.ask("push", joints=goal.tolist())
    until(lambda: np.abs(robot.state().joints - goal).max() < 1e-3, "the arm where it was pushed")
    return goal


def test_the_arm_can_be_pushed_only_while_it_is_free(simulated, connect):
    with connect(simulated) as robot:
        with pytest.raises(SimulationError, match="not in freedrive"):
            push(simulated, robot)
        robot.freedrive(True)
        goal = push(simulated, robot)
        robot.freedrive(False)
        with pytest.raises(SimulationError, match="not in freedrive"):
            push(simulated, robot)
        robot.move_to(goal - STEP, speed=0.5, acceleration=1.0)
        np.testing.assert_allclose(robot.state().joints, goal - STEP, atol=1e-3)


def test_a_stop_holds_the_arm(simulated, connect):
    with connect(simulated) as robot:
        robot.freedrive(True)
        push(simulated, robot)
        robot.stop()
        until(lambda: not simulated.ask("truth")["freedrive"], "the arm held")


def test_the_arm_is_held_when_the_program_ends(simulated, connect):
    with connect(simulated) as robot:
        robot.freedrive(True)
    until(lambda: not simulated.ask("truth")["freedrive"], "the arm held")
