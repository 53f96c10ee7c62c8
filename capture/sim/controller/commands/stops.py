"""stopJ and stopL, and the protective stop that a client asks for."""

from koala3d.capture.drivers.ur.modes import SafetyMode
from koala3d.capture.sim.controller.commands.registers import Action, Body, Registers


def _stop(at: Registers, *, of_tool: bool) -> Body | None:
    """An asynchronous stop ends the operation that it stops, once the arm stands still; it is none of its own."""
    at.require_free()
    deceleration = at.number(0)
    if of_tool:
        at.arm.stop_tool(deceleration, at.now)
    else:
        at.arm.stop(deceleration, at.now)
    return None if at.int_argument(1) else at.until_rest()


ACTIONS: dict[int, Action] = {
    31: lambda at: at.arm.stop_for_safety(SafetyMode.PROTECTIVE_STOP, at.now),
    33: lambda at: _stop(at, of_tool=True),
    34: lambda at: _stop(at, of_tool=False),
}
