"""A small session with the real planner, and an arm that flies without taking pictures."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.planning import Obstacles, connect
from koala3d.capture.sessions.adaptive.candidates import ReachableView, dense, within_reach
from koala3d.capture.sessions.adaptive.loop import CandidateViews, Known, Why
from koala3d.capture.sessions.adaptive.places import Places, of_box
from koala3d.capture.sessions.adaptive.shape import eye_of

CARRIER = RigDescription().carrier()


@dataclass
class FlyingArm:
    """Implements `capture.sessions.adaptive.loop.ViewTaker`; the object's surface is known."""

    places: Places
    obstacles: Obstacles
    changing: float = 0.0
    present: np.ndarray = field(default_factory=lambda: np.radians([0.0, -90.0, 90.0, -90.0, -90.0, 0.0]))
    flown: list[np.ndarray] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def taken(self) -> int:
        return len(self.flown)

    def joints(self) -> np.ndarray:
        return self.present

    def choose(self, joints: np.ndarray, why: Why) -> None:
        connect(self.present, joints, self.obstacles)
        self.present = joints
        self.flown.append(CARRIER.base_from_camera(joints))
        self.seconds += 1.0 + why.seconds

    def known(self) -> Known:
        cameras = np.array(self.flown).reshape(-1, 4, 4)
        return Known(self.places, np.full(len(self.places.points), self.changing), cameras, None, "a test")


@pytest.fixture
def carrier() -> Carrier:
    return CARRIER


@pytest.fixture(scope="session")
def trajectory() -> Trajectory:
    """Views from above the horizon on the side of the robot."""
    return load_trajectory("koala_demo", overrides=["views.0.count=20", "views.0.rings=3", "split={train: 16, test: 4}"])


@pytest.fixture(scope="session")
def obstacles(trajectory: Trajectory) -> Obstacles:
    return Obstacles.of(trajectory, CARRIER)


@pytest.fixture(scope="session")
def candidates(trajectory: Trajectory, obstacles: Obstacles) -> list[ReachableView]:
    return within_reach(dense(trajectory, 50), obstacles)[0]


@pytest.fixture
def reach(candidates: list[ReachableView], obstacles: Obstacles) -> CandidateViews:
    return CandidateViews(candidates, obstacles, eye_of(CARRIER.flange_from_camera, None))


@pytest.fixture
def arm(trajectory: Trajectory, obstacles: Obstacles) -> FlyingArm:
    assert trajectory.object is not None
    return FlyingArm(of_box(trajectory.object.corners, 1, 0.02), obstacles)
