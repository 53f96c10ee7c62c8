"""Tests of the arm run with each client of its controller."""

from collections.abc import Callable

import pytest

from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.drivers.ur.settling import Settling


@pytest.fixture
def connect(client: str) -> Callable[..., UniversalRobot]:
    """Makes an arm that talks to the simulated controller through the client under test; not connected yet."""
    return lambda simulated, **options: UniversalRobot(
        simulated.host, settling=Settling(timeout_s=20.0), client=client, **options
    )
