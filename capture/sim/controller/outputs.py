"""Values of the simulated controller's output variables at one moment.

Each is computed at most once, and only where a connection's recipe contains it: a tool pose costs more than the rest of a cycle.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from koala3d.capture.drivers.ur.modes import RobotMode, SafetyMode, is_guarded, may_move
from koala3d.capture.drivers.ur.rtde import wire
from koala3d.capture.model.kinematics import forward, link_frames
from koala3d.capture.sim.controller.motions.arm import Payload
from koala3d.capture.sim.controller.motions.profiles import Joints
from koala3d.capture.sim.controller.state import Controller

STOPPED_STATE, RUNNING_STATE, PAUSED_STATE = 1, 2, 4
SAFETY_BITS = {
    SafetyMode.NORMAL: 1,
    SafetyMode.REDUCED: 1 << 1,
    SafetyMode.PROTECTIVE_STOP: 1 << 2,
    SafetyMode.RECOVERY: 1 << 3,
    SafetyMode.SYSTEM_EMERGENCY_STOP: 1 << 5 | 1 << 7,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7,
    SafetyMode.VIOLATION: 1 << 8,
    SafetyMode.FAULT: 1 << 9,
}
SAFEGUARD_BIT, STOPPED_BIT = 1 << 4, 1 << 10
"""Stopped by a safeguard, and for safety at all."""
GRAVITY = 9.82  # [m/s^2]


def safety_bits(mode: SafetyMode) -> int:
    """Bits of `safety_status_bits` in a safety mode. Those of rare modes are a guess: stopped, and by what the name says."""
    bits = SAFETY_BITS.get(mode, SAFEGUARD_BIT if is_guarded(mode.name) else 0)
    return bits if may_move(mode.name) else bits | STOPPED_BIT


class Outputs:
    """The variables at the controller's time `now` [s], by name; those that never change are zero."""

    def __init__(self, controller: Controller, now: float) -> None:
        self.controller, self.arm, self.now = controller, controller.arm, now

    def __getitem__(self, name: str) -> Any:
        if name in _CHANGING:
            return _CHANGING[name](self)
        register = wire.register_of(name)
        if register is not None:
            kind, number = register
            program = self.controller.program
            if program is None or not name.startswith("output"):
                return 0
            return (program.output_ints if kind == "int" else program.output_doubles)[number]
        kind = wire.type_of(name)
        return [0] * {"VECTOR3D": 3}.get(kind, 6) if kind.startswith("VECTOR") else 0

    @cached_property
    def target(self) -> tuple[Joints, Joints, Joints]:
        """(6,) commanded angles, speeds and accelerations."""
        return self.arm.target(self.now)

    @property
    def felt(self) -> Joints:
        """(3,) acceleration that an accelerometer in the flange of a resting arm measures: away from the ground [m/s^2]."""
        up = np.asarray(self.controller.installed.up)
        return GRAVITY * forward(self.arm.actual(self.now)[0], self.arm.links)[:3, :3].T @ up

    @property
    def payload(self) -> Payload:
        """What the program says that the flange carries, or else what the installation says."""
        return self.arm.payload or Payload(self.controller.installed.payload_kg, None, (0.0,) * 6)

    @cached_property
    def actual(self) -> tuple[Joints, Joints]:
        """(6,) angles and speeds that the encoders measure."""
        return self.arm.measured(self.now)


_CHANGING: dict[str, Callable[[Outputs], Any]] = {
    "timestamp": lambda at: at.now,
    "target_q": lambda at: at.target[0],
    "target_qd": lambda at: at.target[1],
    "target_qdd": lambda at: at.target[2],
    "actual_q": lambda at: at.actual[0],
    "actual_qd": lambda at: at.actual[1],
    "actual_TCP_pose": lambda at: at.controller.tcp_pose(at.actual[0]),
    "target_TCP_pose": lambda at: at.controller.tcp_pose(at.target[0]),
    "actual_TCP_speed": lambda at: at.arm.tool.velocity(*at.actual),
    "target_TCP_speed": lambda at: at.arm.tool.velocity(*at.target[:2]),
    "robot_mode": lambda at: int(at.arm.mode),
    "safety_mode": lambda at: int(at.arm.safety),
    "joint_mode": lambda at: [253] * 6,
    "runtime_state": lambda at: (
        RUNNING_STATE if at.controller.program_running else PAUSED_STATE if at.controller.program_paused else STOPPED_STATE
    ),
    "robot_status_bits": lambda at: (
        int(at.arm.mode is RobotMode.RUNNING) | at.controller.program_running << 1 | at.arm.button << 2
    ),
    "safety_status_bits": lambda at: safety_bits(at.arm.safety),
    "speed_scaling": lambda at: at.arm.speed_fraction,
    "target_speed_fraction": lambda at: at.arm.speed_fraction,
    "actual_main_voltage": lambda at: 48.0,
    "actual_robot_voltage": lambda at: 48.0,
    "payload": lambda at: at.payload.mass,
    "payload_cog": lambda at: at.payload.centre or at.controller.installed.payload_centre,
    "payload_inertia": lambda at: at.payload.inertia,
    "actual_tool_accelerometer": lambda at: at.felt,
    "elbow_position": lambda at: link_frames(at.actual[0], at.arm.links)[2, :3, 3],
    "joint_temperatures": lambda at: [at.arm.warmth.temperature(at.now)] * 6,
    "actual_digital_output_bits": lambda at: at.controller.signals.digital,
    "standard_analog_output0": lambda at: at.controller.signals.analog[0],
    "standard_analog_output1": lambda at: at.controller.signals.analog[1],
}
"""Name to value; every other variable is a register, or zero."""
