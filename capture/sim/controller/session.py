"""One RTDE connection to the simulated controller."""

import asyncio
import struct
from typing import Any, Protocol

from capture.robots.rtde import wire
from capture.robots.rtde.wire import Recipe, packet

CYCLE_HZ = 500
MAX_UNREAD = 1 << 20
"""A client that leaves this many bytes unread is cut off."""


class Registers(Protocol):
    """What a connection uses of the controller."""

    version: tuple[int, int, int, int]
    sessions: "list[Session]"

    def write_inputs(self, values: dict[str, Any]) -> None:
        """Apply what a client has set."""


class Session:
    """One RTDE connection: its recipes and when its next sample is due."""

    def __init__(self, server: Registers, writer: asyncio.StreamWriter) -> None:
        self.server, self.writer = server, writer
        self.inputs: dict[int, Recipe] = {}
        self.output: Recipe | None = None
        self.period_s = 1.0 / CYCLE_HZ
        self.due_s = 0.0
        self.streaming = False
        self.registers: set[str] = set()

    def handle(self, kind: int, payload: bytes) -> bytes:
        """Reply to one packet; empty where there is none."""
        if kind == wire.PROTOCOL_VERSION:
            return packet(kind, b"\x01")
        if kind == wire.CONTROLLER_VERSION:
            return packet(kind, struct.pack(">4I", *self.server.version))
        if kind == wire.OUTPUTS:
            frequency = struct.unpack_from(">d", payload)[0]
            self.output, self.streaming = Recipe(_names(payload[8:])), False
            self.period_s = 1.0 / min(max(frequency, 1.0), CYCLE_HZ)
            return packet(kind, b"\x01" + ",".join(self.output.types).encode())
        if kind == wire.INPUTS:
            return packet(kind, self._register_inputs(Recipe(_names(payload))))
        if kind in (wire.START, wire.PAUSE):
            self.streaming = kind == wire.START and (self.output is None or self.output.complete)
            return packet(kind, b"\x01" if self.streaming or kind == wire.PAUSE else b"\x00")
        if kind == wire.DATA and payload:
            self._receive(payload)
        return b""

    def _register_inputs(self, recipe: Recipe) -> bytes:
        others = [s.registers for s in self.server.sessions if s is not self]
        if any(name in registers for registers in others for name in recipe.names):
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
        except ValueError:
            return  # as the controller does with a packet of the wrong size
        self.server.write_inputs(values)

    def send(self, data: bytes) -> None:
        """Queue bytes, or cut the connection where they are not read."""
        if self.writer.transport.get_write_buffer_size() > MAX_UNREAD:
            self.writer.transport.abort()
        elif data and not self.writer.transport.is_closing():
            self.writer.write(data)


def _names(payload: bytes) -> list[str]:
    return [name for name in payload.decode("latin-1").split(",") if name]
