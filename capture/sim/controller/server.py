"""The simulated controller as a server: RTDE, script and dashboard ports on one loopback address.

One asyncio loop owns everything.
"""

import asyncio
import logging
import random
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from koala3d.capture.drivers.ur.rtde import wire
from koala3d.capture.sim.controller import dashboard, robot_api, script
from koala3d.capture.sim.controller.installation import Installation
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.outputs import Outputs
from koala3d.capture.sim.controller.session import Session
from koala3d.capture.sim.controller.state import Controller
from koala3d.capture.sim.controller.urscript.lexer import ScriptError

RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT = 30004, 30003, 29999
log = logging.getLogger(__name__)


class ControllerServer:
    """The ports of a controller, and the connections to them. Faults are triggered through `side_channel`."""

    def __init__(self, arm: SimulatedArm, time_scale: float, installed: Installation) -> None:
        self.controller = Controller(arm, time_scale, installed, self.report)
        self.sessions: list[Session] = []
        self.listeners: list[Callable[[str, int, int], None]] = []
        """Told of every error with its line and column in the program; 0: it has none."""
        self._latency, self._held_until = random.Random(arm.seed), 0.0

    def report(self, message: str, line: int = 0, column: int = 0) -> None:
        """Log an error and send it to every client."""
        text = str(ScriptError(message, line, column))
        log.warning(text)
        for listener in self.listeners:
            listener(message, line, column)
        for session in list(self.sessions):
            session.send(wire.text_message(text, session.version))

    def step(self) -> None:
        """One cycle of the controller, then data to every connection."""
        self.controller.step()
        if not self.controller.silent and time.monotonic() >= self._held_until:
            if latency_s := self.controller.installed.latency_s:
                self._held_until = time.monotonic() + self._latency.uniform(0.5, 1.0) * latency_s
            wall, outputs = time.monotonic(), Outputs(self.controller, self.controller.now)
            for session in list(self.sessions):
                session.send_sample(outputs, wall)

    def drop(self) -> None:
        """Cut every RTDE connection."""
        for session in list(self.sessions):
            session.writer.transport.abort()

    async def serve_rtde(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one RTDE connection."""
        session = Session(self.controller, self.sessions, writer)
        self.sessions.append(session)
        buffer = bytearray()
        with closing(writer):
            try:
                while chunk := await reader.read(65536):
                    await self._answering()
                    buffer += chunk
                    for kind, payload in wire.split_packets(buffer):
                        session.send(session.handle(kind, payload))
            finally:
                self.sessions.remove(session)

    async def serve_script(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection of the script port."""
        with closing(writer):
            if refused := await self.take_programs(reader):
                writer.write(f"{refused}\n".encode())

    async def take_programs(self, reader: asyncio.StreamReader) -> str:
        """Run what arrives: every "def ...: ... end" is a program. Returns why something was refused, or nothing at the end."""
        text, chunk = bytearray(), b"..."
        while chunk:
            chunk = await reader.read(65536)
            await self._answering()
            text += chunk
            try:
                if script.is_whole(text):
                    self.controller.upload(text.decode("latin-1"))
                    text.clear()
                else:
                    script.check_part(text, ended=not chunk)
            except ScriptError as error:
                self.report(error.why, error.line, error.column)
                return str(error)
        return ""

    async def serve_dashboard(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection of the dashboard; no more is read from a client that does not read the answers."""
        with closing(writer):
            await self._answering()
            if not self.controller.installed.dashboard:
                return
            writer.write(f"{dashboard.GREETING}\n".encode())
            while line := await reader.readline():
                await self._answering()
                if line.strip().lower() == b"quit":
                    writer.write(b"Disconnected\n")
                    return
                writer.write(f"{dashboard.reply(self.controller, line.decode('latin-1'))}\n".encode())
                await writer.drain()

    async def serve_robot_api(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection of the Robot API, which is one request."""
        with closing(writer):
            await self._answering()
            await robot_api.serve(self.controller, reader, writer)

    async def _answering(self) -> None:
        """Return once the controller answers: a hung one accepts connections and then sends nothing."""
        while self.controller.hung:
            await asyncio.sleep(0.02)


@contextmanager
def closing(writer: asyncio.StreamWriter) -> Iterator[None]:
    """Close the connection at the end, and where the client breaks it or sends what is no line or packet."""
    try:
        yield
    except (ConnectionError, EOFError, ValueError, struct.error):
        return
    finally:
        writer.close()
