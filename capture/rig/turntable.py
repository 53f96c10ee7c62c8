"""The turntable of a rig: its driver, and what simulates it. Neither where the trajectory turns no table."""

from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from koala3d.capture.drivers.protocols import Turntable
from koala3d.capture.model.turntable import TurntableDescription

if TYPE_CHECKING:
    from koala3d.capture.sim.turntable import SimulatedTurntable


def open_turntable(table: TurntableDescription | None) -> AbstractContextManager[Turntable | None]:
    """The driver, not connected; entering it connects, and turns the table if it looks for its switch."""
    if table is None:
        return nullcontext()
    from koala3d.capture.drivers.turntable.grbl import GrblTurntable

    return GrblTurntable(table)


def simulated_turntable(
    table: TurntableDescription | None, *, seed: int, time_scale: float
) -> AbstractContextManager["SimulatedTurntable | None"]:
    """A simulated controller with the object on its table, not started; arguments as in `SimulatedTurntable`."""
    if table is None:
        return nullcontext()
    from koala3d.capture.sim.turntable import SimulatedTurntable

    return SimulatedTurntable(table, seed, time_scale)
