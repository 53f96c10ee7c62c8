"""One RTDE connection to the simulated controller."""

import asyncio
import struct

from koala3d.capture.drivers.ur.rtde import wire
from koala3d.capture.drivers.ur.rtde.wire import Recipe, packet
from koala3d.capture.sim.controller.outputs import Outputs
from koala3d.capture.sim.controller.state import Controller

CYCLE_HZ = 500
MAX_UNREAD = 1 << 20  # a client that leaves this many bytes unread is cut off


class Session:
    """One RTDE connection: its protocol version, its recipes and when its next sample is due.

    Args:
        sessions: all of the controller; an input register belongs to one of them.
    """

    def __init__(self, controller: Controller, sessions: "list[Session]", writer: asyncio.StreamWriter) -> None:
        self.controller, self.sessions, self.writer = controller, sessions, writer
        self.version = 1  # until a client asks for another one
        self.inputs: dict[int, Recipe] = {}
        self.output: Recipe | None = None
        self.period_s = 1.0 / CYCLE_HZ
        self.due_s = 0.0
        self.streaming = False
        self.registers: set[str] = set()

    def handle(self, kind: int, payload: bytes) -> bytes:
        """Reply to one packet; empty where there is none."""
        if kind == wire.PROTOCOL_VERSION:
            version = struct.unpack(">H", payload)[0]
            accepted = version in wire.VERSIONS
            self.version = version if accepted else self.version
            return packet(kind, bytes([accepted]))
        if kind == wire.CONTROLLER_VERSION:
            return packet(kind, struct.pack(">4I", *self.controller.installed.version))
        if kind == wire.OUTPUTS:
            frequency, names = (struct.unpack_from(">d", payload)[0], payload[8:]) if self.version > 1 else (CYCLE_HZ, payload)
            self.output, self.streaming = Recipe(_names(names)), False
            self.period_s = 1.0 / min(max(frequency, 1.0), CYCLE_HZ)
            return packet(kind, self._number + ",".join(self.output.types).encode())
        if kind == wire.INPUTS:
            return packet(kind, self._register_inputs(Recipe(_names(payload), is_input=True)))
        if kind in (wire.START, wire.PAUSE):
            self.streaming = kind == wire.START and (self.output is None or self.output.complete)
            return packet(kind, bytes([self.streaming or kind == wire.PAUSE]))
        if kind == wire.DATA and payload:
            self._receive(payload)
        return b""

    @property
    def _number(self) -> bytes:
        """Of the output recipe, as it travels; version 1 has one recipe and no numbers."""
        return b"\x01" if self.version > 1 else b""

    def send_sample(self, outputs: Outputs, wall_s: float) -> None:
        """Send the variables of the recipe where they are due."""
        if self.streaming and self.output is not None and wall_s >= self.due_s:
            self.due_s = max(self.due_s + self.period_s, wall_s)
            self.send(packet(wire.DATA, self._number + self.output.pack([outputs[name] for name in self.output.names])))

    def _register_inputs(self, recipe: Recipe) -> bytes:
        if any(not session.registers.isdisjoint(recipe.names) for session in self.sessions if session is not self):
            return b"\x00" + b",".join(b"IN_USE" for _ in recipe.names)
        if not recipe.complete:
            return b"\x00" + ",".join(recipe.types).encode()
        self.registers.update(recipe.names)
        number = len(self.inputs) + 1
        self.inputs[number] = recipe
        return bytes([number]) + ",".join(recipe.types).encode()

    def _receive(self, payload: bytes) -> None:
        recipe = self.inputs.get(payload[0])
        if recipe is None:
            return
        try:
            values = recipe.unpack(payload[1:])
        except ValueError as error:
            self.controller.report(f"a packet was ignored: {error}: {', '.join(recipe.names[:3])} and so on")
            return
        self.controller.write_inputs(values)

    def send(self, data: bytes) -> None:
        """Queue bytes, or cut the connection where they are not read."""
        if self.writer.transport.get_write_buffer_size() > MAX_UNREAD:
            self.writer.transport.abort()
        elif data and not self.writer.transport.is_closing():
            self.writer.write(data)


def _names(payload: bytes) -> list[str]:
    return [name for name in payload.decode("latin-1").split(",") if name]
