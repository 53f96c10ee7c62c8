"""The simulated controller as a server: RTDE, script and dashboard ports on one loopback address.

One asyncio loop owns everything. Controller time runs `time_scale` times as fast as the clock on the wall.
"""

import asyncio
import struct
import time
from typing import Any

import numpy as np

from capture.robots.rtde import wire
from capture.robots.rtde.wire import packet
from capture.sim.controller import dashboard
from capture.sim.controller.arm import Arm
from capture.sim.controller.outputs import Outputs
from capture.sim.controller.script import ControlProgram
from capture.sim.controller.session import Session
from datasets import pose

RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT = 30004, 30003, 29999
VERSION = (5, 11, 5, 1010327)


class ControllerServer:
    """Everything behind the three ports. Its faults are triggered through `side_channel`."""

    def __init__(self, arm: Arm, time_scale: float, version: tuple[int, int, int, int] = VERSION) -> None:
        self.arm, self.time_scale, self.version = arm, time_scale, version
        self.program: ControlProgram | None = None
        self.sessions: list[Session] = []
        self.digital_outputs = 0
        self.silent_until, self.hung_until = 0.0, 0.0
        self.deaf = False
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
        return self.program is not None and self.program.running and not self.program.paused

    @property
    def program_paused(self) -> bool:
        """Whether a program is paused."""
        return self.program is not None and self.program.paused

    @property
    def silent(self) -> bool:
        """Whether the data stream is frozen by a fault."""
        return time.monotonic() < max(self.silent_until, self.hung_until)

    def stop_program(self) -> None:
        """End the program; the arm slows down."""
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
        """Start a program, as the script port does with every text that it receives."""
        if not self.arm.may_move:
            return
        previous, self.program = self.program, ControlProgram(self.arm, text)
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
        if "speed_slider_fraction" in values:
            self.arm.set_speed_slider(values["speed_slider_fraction"], self.now)
        if "standard_digital_output" in values:
            mask = values.get("standard_digital_output_mask", 0)
            self.digital_outputs = (self.digital_outputs & ~mask) | (values["standard_digital_output"] & mask)
        if program is not None and not self.deaf:
            program.cycle(self.now)

    def step(self) -> None:
        """One cycle: program, safety, watchdog, data to every connection."""
        program, now = self.program, self.now
        self.arm.check_limits(now)
        if program is not None and program.running:
            late = time.monotonic() - self._input_written_s
            if not self.arm.may_move or (program.watchdog_s is not None and late > program.watchdog_s):
                program.end(now)
            elif not self.deaf:
                program.cycle(now)
        if self.silent:
            return
        wall, outputs = time.monotonic(), Outputs(self, now)
        for session in list(self.sessions):
            if session.streaming and session.output is not None and wall >= session.due_s:
                session.due_s = max(session.due_s + session.period_s, wall)
                session.send(packet(wire.DATA, b"\x01" + session.output.pack([outputs[n] for n in session.output.names])))

    def tcp_pose(self, joints: np.ndarray) -> np.ndarray:
        """(6,) position [m] and rotation vector [rad]; cached for an arm at rest."""
        key = joints.tobytes() + self.arm.flange_from_tcp.tobytes()
        if key not in self._poses:
            base_from_tcp = self.arm.base_from_tcp(joints)
            self._poses = {key: np.concatenate([base_from_tcp[:3, 3], pose.rotation_vector(base_from_tcp)])}
        return self._poses[key]

    async def rtde(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one RTDE connection."""
        session = Session(self, writer)
        self.sessions.append(session)
        buffer = bytearray()
        try:
            while chunk := await reader.read(65536):
                await self._answering()
                buffer += chunk
                for kind, payload in wire.split_packets(buffer):
                    session.send(session.handle(kind, payload))
        except (ConnectionError, ValueError, struct.error):
            return  # a connection that breaks, or does not speak RTDE, is closed
        finally:
            self.sessions.remove(session)
            writer.close()

    async def script(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection of the script port: every "def ...: ... end" is a program."""
        text = ""
        try:
            while chunk := await reader.read(65536):
                await self._answering()
                text += chunk.decode("latin-1")
                if text.rstrip().endswith("\nend") and text.endswith("\n"):
                    self.upload(text)
                    text = ""
        except ConnectionError:
            return
        finally:
            writer.close()

    async def dashboard(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection of the dashboard."""
        try:
            await self._answering()
            writer.write(f"{dashboard.GREETING}\n".encode())
            while line := await reader.readline():
                await self._answering()
                if line.strip().lower() == b"quit":
                    writer.write(b"Disconnected\n")
                    break
                writer.write(f"{dashboard.reply(self, line.decode('latin-1'))}\n".encode())
        except (ConnectionError, ValueError):
            return
        finally:
            writer.close()

    async def _answering(self) -> None:
        """Return once the controller answers: a hung one accepts connections and then sends nothing."""
        while time.monotonic() < self.hung_until:
            await asyncio.sleep(0.02)
