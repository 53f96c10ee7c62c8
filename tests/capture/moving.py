"""A simulated arm on a long way, as tests observe it: in the middle of the motion, and stopped on the way.

with in_motion(controller, lambda: controller.ask("protective_stop")):
    robot.move_to(FAR, **UNHURRIED)
assert stopped_on_its_way(controller)
"""

from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np

from koala3d.capture.sim.controller.handle import ControllerHandle
from tests.moments import as_soon_as, until

FAR = np.array([2.0, -1.2, 0.8, -1.5, -1.0, 0.2])
"""Joint angles two radians from where the simulated arm starts [rad]."""
UNHURRIED = {"speed": 0.4, "acceleration": 1.4}
"""For `move_to`: the way to `FAR` then takes five seconds, of which a fault in the middle leaves most."""
SHARE, LONG_S = 0.1, 0.5
"""A tenth of a motion is its middle, since most of it should be left. Shorter ones are over too soon [s, controller's clock]."""
STILL_RAD_S = 1e-3
LEFT_RAD = 0.3


def moves(controller: ControllerHandle) -> bool:
    """Whether the arm is in the middle of a motion."""
    truth = controller.ask("truth")
    return truth["moving"] and truth["motion_s"] > LONG_S and truth["phase_s"] > SHARE * truth["motion_s"]


def in_motion(controller: ControllerHandle, act: Callable[[], object]) -> AbstractContextManager[None]:
    """Act once within the block, in the middle of its first long motion. Raises AssertionError: there was none."""
    return as_soon_as(lambda: moves(controller), act, "the middle of a motion")


def rests(controller: ControllerHandle) -> bool:
    """Whether the arm stands still."""
    truth = controller.ask("truth")
    return not truth["moving"] and max(map(abs, truth["speeds"])) < STILL_RAD_S


def stopped_on_its_way(controller: ControllerHandle) -> bool:
    """Whether the arm comes to rest before it is at `FAR`."""
    until(lambda: rests(controller), "the arm at rest")
    return bool(np.abs(controller.ask("truth")["joints"] - FAR).max() > LEFT_RAD)
