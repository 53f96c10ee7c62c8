"""A session of the demo as the default arm takes it, planned once."""

import pytest

from koala3d.capture.planning import PlannedView, plan
from koala3d.capture.rig.description import RigDescription
from koala3d.capture.trajectory import Trajectory, load_trajectory


@pytest.fixture(scope="session")
def demo() -> Trajectory:
    return load_trajectory("koala_demo")


@pytest.fixture(scope="session")
def demo_views(demo: Trajectory) -> list[PlannedView]:
    """Its first six views."""
    return plan(demo, RigDescription().carrier())[:6]
