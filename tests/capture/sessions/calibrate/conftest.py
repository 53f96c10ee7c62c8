"""A rehearsal: the real adviser, planner and loop, and a simulated rig without pictures."""

from collections.abc import Iterator

import pytest

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.planning import Obstacles
from koala3d.capture.sessions.calibrate.adviser import Adviser
from koala3d.datasets.advice import Question
from tests.bench.rehearsals import RehearsedArm

CARRIER = RigDescription().carrier()


@pytest.fixture
def carrier() -> Carrier:
    return CARRIER


@pytest.fixture(scope="session")
def trajectory() -> Trajectory:
    return load_trajectory("calibration")


@pytest.fixture(scope="session")
def running() -> Iterator[Adviser]:
    with Adviser("rehearsal", ["--rehearse"]) as adviser:
        yield adviser


@pytest.fixture
def arm(running: Adviser, trajectory: Trajectory) -> RehearsedArm:
    """At the start of a session of rig 1."""
    running.ask(Question(rehearse=1))
    return RehearsedArm(trajectory, running, Obstacles.of(trajectory, CARRIER))
