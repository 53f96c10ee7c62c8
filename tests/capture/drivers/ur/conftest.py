"""Tests of the arm run with each client of its controller."""

from collections.abc import Callable

import pytest

from koala3d.capture.drivers.ur.link import Deadlines
from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.drivers.ur.settling import Settling

BUSY = Deadlines(stale_s=1.0, watchdog_hz=1.0)
"""Tests run beside others on two cores: a pause of half a second is no fault there."""


@pytest.fixture
def connect(client: str) -> Callable[..., UniversalRobot]:
    """Makes an arm that talks to the simulated controller through the client under test; not connected yet."""
    return lambda simulated, **options: UniversalRobot(
        simulated.host, settling=Settling(timeout_s=20.0), deadlines=BUSY, client=client, **options
    )
