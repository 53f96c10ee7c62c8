"""Opens the turntable of a rig, real or simulated; none where the trajectory needs none."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from capture.rig.description import RigDescription
from capture.rig.protocols import Turntable
from capture.trajectory import Trajectory
from datasets.core.errors import UsageError

if TYPE_CHECKING:
    from capture.sim.turntable import SimulatedTurntable

Opened = tuple[Turntable | None, "SimulatedTurntable | None"]


@contextmanager
def open_turntable(
    description: RigDescription, trajectory: Trajectory, *, simulated: bool, seed: int = 0, time_scale: float = 1.0
) -> Iterator[Opened]:
    """Connect the turntable. The second value knows the truth, of a simulated table.

    Raises UsageError: the trajectory turns a table and the rig has none.
    """
    if not trajectory.turns:
        yield None, None
        return
    if description.turntable is None:
        remedy = "describe one under 'turntable' in the rig file, or choose a rig that has one"
        raise UsageError("the rig has no turntable", where=trajectory.name, why="its views turn one", remedy=remedy)
    from capture.turntables.grbl import GrblTurntable

    if not simulated:
        with GrblTurntable(description.turntable) as table:
            yield table, None
        return
    from capture.sim.turntable import SimulatedTurntable

    with SimulatedTurntable(description.turntable, seed, time_scale) as simulation:
        with GrblTurntable(simulation.reached) as table:
            yield table, simulation
