"""The simulated controller apart from its ports: its arm, its settings, the program that runs, and the faults that are on."""

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from koala3d.capture.drivers.ur.modes import SafetyMode, is_guarded
from koala3d.capture.drivers.ur.rtde import wire
from koala3d.capture.model.kinematics import six_from_pose
from koala3d.capture.sim.controller import script, signals
from koala3d.capture.sim.controller.installation import Installation
from koala3d.capture.sim.controller.motions.arm import SimulatedArm

SIMULATED_INPUTS = signals.NAMES | {"speed_slider_fraction", "speed_slider_mask"}
"""Inputs besides the registers. Writing any other one ends the program."""


class Controller:
    """What every port reads and changes. Controller time runs `time_scale` times as fast as the clock on the wall.

    Args:
        report: called with what goes wrong in a program.
    """

    def __init__(self, arm: SimulatedArm, time_scale: float, installed: Installation, report: Callable[[str], None]) -> None:
        self.arm, self.time_scale, self.installed, self.report = arm, time_scale, installed, report
        self.up, self.links = installed.up, arm.links  # as it was started
        self.program: script.ControlProgram | None = None
        self.signals = signals.Signals()
        self.silent_until, self.hung_until = 0.0, 0.0
        self.deaf, self.unstoppable = False, False
        self.guarded_until = math.inf  # real time at which a safeguard lets the program go on by itself [s]
        self._input_written_s = 0.0
        self._start = time.monotonic()
        self._poses: dict[bytes, np.ndarray] = {}

    @property
    def now(self) -> float:
        """Controller time [s]."""
        return 100.0 + (time.monotonic() - self._start) * self.time_scale

    @property
    def program_running(self) -> bool:
        """Whether a program runs and is not paused."""
        own = self.program is not None and self.program.running and not self.program.paused
        return own or self.installed.program == "PLAYING"

    @property
    def program_paused(self) -> bool:
        """Whether a program is paused."""
        return (self.program is not None and self.program.paused) or self.installed.program == "PAUSED"

    @property
    def hung(self) -> bool:
        """Whether a fault keeps every port from answering."""
        return time.monotonic() < self.hung_until

    @property
    def silent(self) -> bool:
        """Whether the data stream is frozen by a fault."""
        return time.monotonic() < max(self.silent_until, self.hung_until)

    def stop_program(self) -> None:
        """End the program; the arm slows down."""
        self.installed.program = ""
        if self.program is not None:
            self.program.end(self.now)

    def pause_program(self) -> bool:
        """Pause the program; False where none ran. The arm comes to rest on its path."""
        if self.program is None or not self.program_running:
            return False
        self.program.paused = True
        self.arm.pause(self.now)
        return True

    def play_program(self) -> bool:
        """Resume the program and the motion; False where none was paused."""
        if self.program is None or not self.program_paused:
            return False
        self.program.paused = False
        self.arm.resume(self.now)
        return True

    def upload(self, text: str) -> None:
        """Start a program, as the script port does with every one that it receives. Raises ScriptError: it is refused."""
        if (deceleration := script.stop_of(text)) is not None:
            if not self.unstoppable:
                self.stop_program()
                self.arm.stop(deceleration, self.now)
            return
        script.check(text)
        if self.arm.may_move:
            self.installed.program = ""
            previous, self.program = self.program, script.ControlProgram(self.arm, text, self.report)
            if previous is not None:
                self.program.input_ints, self.program.input_doubles = previous.input_ints, previous.input_doubles
            self.arm.stop(3.0, self.now)
            self._input_written_s = time.monotonic()
            self.program.cycle(self.now)

    def write_inputs(self, values: dict[str, Any]) -> None:
        """Registers and outputs that a client sets; the program sees them at once."""
        program = self.program
        for name, value in values.items():
            register = wire.register_of(name)
            if register is not None and program is not None:
                kind, number = register
                (program.input_ints if kind == "int" else program.input_doubles)[number] = value
                if program.offset == number and kind == "int":
                    self._input_written_s = time.monotonic()
            elif register is None and name not in SIMULATED_INPUTS and self.program_running and program is not None:
                program.fail(f"input {name} is not simulated")
        if values.get("speed_slider_mask"):  # without its bit the fraction is not used
            self.arm.set_speed_slider(values["speed_slider_fraction"], self.now)
        self.signals.write(values)
        if program is not None and not self.deaf:
            program.cycle(self.now)

    def step(self) -> None:
        """One cycle of the program, the safety limits and the watchdog."""
        program, now = self.program, self.now
        self.arm.check_limits(now)
        if self.arm.why:
            self.report(self.arm.why)
            self.arm.why = ""
        guarded = is_guarded(self.arm.safety.name)
        if guarded:
            self.pause_program()
        if guarded and time.monotonic() > self.guarded_until:
            self.arm.safety, guarded = SafetyMode.NORMAL, False
            self.play_program()
        if program is not None and program.running:
            late = time.monotonic() - self._input_written_s
            stopped = not self.arm.may_move and not guarded
            if stopped or (program.watchdog_s is not None and late > program.watchdog_s):
                program.end(now)
            elif not self.deaf:
                program.cycle(now)

    def tcp_pose(self, joints: np.ndarray) -> np.ndarray:
        """(6,) position [m] and rotation vector [rad]; cached for an arm at rest."""
        key = joints.tobytes() + self.arm.flange_from_tcp.tobytes()
        if key not in self._poses:
            self._poses = {key: six_from_pose(self.arm.base_from_tcp(joints))}
        return self._poses[key]
