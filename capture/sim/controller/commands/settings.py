"""What a program sets: the tool's offset, the payload, the watchdog; and freedrive, in which a person moves the arm."""

import numpy as np

from koala3d.capture.model.kinematics import pose_from_six, singularity
from koala3d.capture.sim.controller.commands.registers import Action, Answer, Registers
from koala3d.capture.sim.controller.motions.arm import Payload

NEAR_SINGULARITY, AT_SINGULARITY = 0.1, 0.04
"""Smallest singular value of the jacobian below which freedrive warns, and resists. The controller's own are not published."""


def _set_tcp(at: Registers) -> None:
    at.arm.flange_from_tcp = pose_from_six(at.arguments(0, 6))


def _set_payload(at: Registers, inertia: tuple[float, ...] | None = None) -> None:
    """A centre of gravity of three zeros means the present one."""
    centre = at.arguments(1, 3)
    kept = at.arm.payload.centre if at.arm.payload is not None else None
    at.arm.payload = Payload(at.number(0), tuple(centre.tolist()) if centre.any() else kept, inertia or (0.0,) * 6)


def _set_watchdog(at: Registers) -> None:
    at.watchdog_s = 1.0 / max(at.number(0), 1e-3)


def _free(at: Registers, *, free: bool) -> None:
    if free:
        at.require_free()
        at.arm.stop(3.0, at.now)
    at.arm.freedrive = free


def _status(at: Registers) -> int:
    """0: moves freely, 1: near a singularity, 2: at one."""
    distance = float(singularity(at.joints, at.arm.links))
    return int(distance < NEAR_SINGULARITY) + int(distance < AT_SINGULARITY)


ACTIONS: dict[int, Action] = {
    17: _set_payload,
    18: lambda at: _free(at, free=True),
    19: lambda at: _free(at, free=False),
    29: _set_tcp,
    35: _set_watchdog,
    52: lambda at: _free(at, free=True),
    53: lambda at: _free(at, free=False),
    65: lambda at: _set_payload(at, tuple(at.arguments(4, 6).tolist())),
}
ANSWERS: dict[int, Answer] = {54: _status, 40: lambda at: np.asarray(at.arm.flange_from_tcp)}
