"""A session of the demo as the default arm takes it, planned once."""

import pytest

from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.planning import PlannedView, plan


@pytest.fixture(scope="session")
def demo() -> Trajectory:
    return load_trajectory("koala_demo")


@pytest.fixture(scope="session")
def demo_views(demo: Trajectory) -> list[PlannedView]:
    """Its first six views."""
    return plan(demo, RigDescription().carrier())[:6]
