"""Slow first moves, the speed factor, and questions: with the real client at a simulated controller that keeps its motions."""

from collections.abc import Iterator

import numpy as np
import pytest

from koala3d.capture.drivers.errors import MotionError, StopLatched
from koala3d.capture.drivers.ur.link import Deadlines
from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Motion
from koala3d.capture.planning import Obstacles, Pace
from koala3d.capture.rig.moves import Moves, NextMove
from koala3d.capture.sim.controller.process import SimulatedController

OBSTACLES = Obstacles(RigDescription().carrier(), 0.02, table_z=0.0)
MOTION = Motion(speed=1.0, acceleration=1.4)
HERE = np.radians([0, -90, 80, -80, -90, 0.0])
THERE = np.add(HERE, [0.1, 0, 0.05, 0, 0, 0.2])


@pytest.fixture(scope="module")
def simulated() -> Iterator[SimulatedController]:
    with SimulatedController.start(seed=1, time_scale=50.0, home=HERE) as controller:
        yield controller


@pytest.fixture
def robot(simulated: SimulatedController) -> Iterator[UniversalRobot]:
    with UniversalRobot(simulated.host, deadlines=Deadlines(stale_s=2.0, watchdog_hz=0.5)) as arm:
        yield arm


def last_duration(controller: SimulatedController) -> float:
    """Of the newest motion, on the controller's clock [s]."""
    return float(controller.ask("motions")["motions"][-1][1])


def at_0_1_rad_s(travel: float) -> float:
    """Duration of a move of the fastest joint by `travel` [rad] at 0.1 rad/s and 1.4 rad/s^2 [s]."""
    return travel / 0.1 + 0.1 / 1.4


def test_the_first_move_is_slow_and_so_is_the_one_after_a_stop(simulated: SimulatedController, robot: UniversalRobot) -> None:
    said: list[str] = []
    moves = Moves(say=said.append)
    present = robot.state().joints

    def go(target: np.ndarray, name: str) -> float:
        moves.along(robot, [target], MOTION, OBSTACLES, view=name)
        return last_duration(simulated)

    assert go(THERE, "view 000") == pytest.approx(at_0_1_rad_s(np.abs(THERE - present).max()), rel=1e-3)
    full = Pace.of(THERE, HERE, MOTION, OBSTACLES.carrier)
    assert go(HERE, "view 001") == pytest.approx(full.seconds, rel=1e-2) and full.seconds < at_0_1_rad_s(0.2) / 2
    assert len(said) == 1 and said[0].startswith("first move, to view 000: no joint faster than 0.1 rad/s, about 2 s")
    robot.stop()
    with pytest.raises(MotionError, match="stopped on request"):
        go(THERE, "view 002")
    robot.clear_stop()
    assert go(THERE, "view 002") == pytest.approx(at_0_1_rad_s(0.2), rel=1e-2)
    assert len(said) == 2 and "view 002" in said[-1]
    assert go(HERE, "view 003") < at_0_1_rad_s(0.2) / 2


def test_every_corner_of_the_first_path_is_slow_and_the_factor_slows_all_moves(
    simulated: SimulatedController, robot: UniversalRobot
) -> None:
    moves = Moves(slow=0.5)
    moves.along(robot, [HERE, THERE, HERE], MOTION, OBSTACLES, view="view 000")
    last = simulated.ask("motions")["motions"][-2:]
    assert [duration for _, duration, _ in last] == pytest.approx([0.2 / 0.1 + 0.1 / 0.7] * 2, rel=1e-2)  # half of 1.4 rad/s^2
    moves.along(robot, [THERE], MOTION, OBSTACLES, view="view 001")
    slow = Pace.of(HERE, THERE, MOTION, OBSTACLES.carrier, slow=0.5)
    assert last_duration(simulated) == pytest.approx(slow.seconds, rel=1e-2)


def test_a_person_is_asked_with_the_facts_and_may_end_it(simulated: SimulatedController, robot: UniversalRobot) -> None:
    asked: list[NextMove] = []

    def ask(move: NextMove) -> bool:
        asked.append(move)
        return len(asked) < 2

    moves, count = Moves(ask=ask), len(simulated.ask("motions")["motions"])
    moves.along(robot, [HERE], MOTION, OBSTACLES, view="view 007")
    with pytest.raises(StopLatched, match=r"ended at the terminal, the arm stands still.*--resume") as caught:
        moves.along(robot, [THERE], MOTION, OBSTACLES, view="view 008")
    assert "before view 008" in str(caught.value)
    assert len(simulated.ask("motions")["motions"]) == count + 1, "the second one has not begun"
    pace = asked[1].paces[0]
    room = 1e3 * (OBSTACLES.margin(np.linspace(HERE, THERE, 200)).min() + 0.02)
    expected = f"view 008: joint 1 by 6, joint 3 by 3, joint 6 by 11 degrees, at most {pace.speed:.2f} rad/s and "
    assert asked[1].words.startswith(expected)
    told = float(asked[1].words.rsplit(" s, ", 1)[1].split(" mm from")[0])
    assert room - 2 < told <= room + 0.5
