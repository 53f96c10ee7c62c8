"""One RTDE connection: a stream of output variables, and packets of input registers. Every call has a deadline."""

import select
import socket
import struct
import time
from collections.abc import Sequence
from typing import Any

from koala3d.capture.drivers.ur.rtde import wire
from koala3d.capture.drivers.ur.rtde.wire import Recipe, packet

PORT = 30004
REPLY_S = 2.0


class RegistersInUse(ConnectionError):
    """Another client owns the input registers."""


class RtdeStream:
    """The connection. After an error or a closed socket `connected` is False for good.

    Args:
        outputs: variables to receive.
        inputs: variables to send; the lists get the numbers 1, 2, ... for `send`.
        frequency: samples asked of the controller [Hz].

    Raises:
        RegistersInUse: an input variable belongs to another client.
        OSError: nobody answers, or not as a controller does.
    """

    def __init__(self, host: str, outputs: Sequence[str], inputs: Sequence[Sequence[str]], frequency: float) -> None:
        self.connected = True
        self._buffer = bytearray()
        self._outputs = Recipe(outputs)
        self._inputs = [Recipe(names, is_input=True) for names in inputs]
        self._link = socket.create_connection((host, PORT), REPLY_S)
        try:
            self._link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._negotiate(frequency)
        except BaseException:
            self._link.close()
            raise

    def newest(self, wait_s: float = 0.0) -> dict[str, Any] | None:
        """The newest sample received, waiting for one where none is there; None: none came in time, or not `connected`."""
        sample, deadline = None, time.monotonic() + wait_s
        while self.connected:
            left = 0.0 if sample else max(0.0, deadline - time.monotonic())
            if not select.select([self._link], [], [], left)[0]:
                break
            try:
                self._fill()
                samples = [payload for kind, payload in wire.split_packets(self._buffer) if kind == wire.DATA]
                sample = self._outputs.unpack(samples[-1][1:]) if samples else sample
            except (OSError, ValueError):  # closed, or no longer RTDE
                self.close()
        return sample

    def send(self, number: int, values: Sequence[float]) -> None:
        """Set the inputs of list `number`; closes the connection where that fails."""
        if not self.connected:
            return
        recipe = self._inputs[number - 1]
        try:
            self._link.sendall(packet(wire.DATA, bytes([number]) + recipe.pack(values)))
        except OSError:
            self.close()

    def close(self) -> None:
        """Close the connection; may be called twice."""
        self.connected = False
        self._link.close()

    def _negotiate(self, frequency: float) -> None:
        if self._ask(wire.PROTOCOL_VERSION, struct.pack(">H", 2)) != b"\x01":
            raise ConnectionError("the controller does not speak RTDE version 2")
        types = self._ask(wire.OUTPUTS, struct.pack(">d", frequency) + ",".join(self._outputs.names).encode())[1:]
        self._check(self._outputs, types)
        for number, recipe in enumerate(self._inputs, start=1):
            reply = self._ask(wire.INPUTS, ",".join(recipe.names).encode())
            if b"IN_USE" in reply:
                raise RegistersInUse("another client uses the controller's input registers")
            self._check(recipe, reply[1:])
            if reply[0] != number:
                raise ConnectionError(f"the controller numbers its input recipes {reply[0]} where {number} is due")
        if self._ask(wire.START) != b"\x01":
            raise ConnectionError("the controller does not start its data stream")

    def _check(self, recipe: Recipe, types: bytes) -> None:
        received = types.decode("latin-1").split(",")
        wrong = [f"{name} {kind}" for name, ours, kind in zip(recipe.names, recipe.types, received, strict=False) if ours != kind]
        if wrong or len(received) != len(recipe.names):
            raise ConnectionError(f"the controller has other variables: {', '.join(wrong) or received}")

    def _ask(self, kind: int, payload: bytes = b"") -> bytes:
        """Reply to a packet; text messages and samples in between are dropped."""
        deadline = time.monotonic() + REPLY_S
        self._link.settimeout(REPLY_S)
        self._link.sendall(packet(kind, payload))
        while time.monotonic() < deadline:
            for answered, reply in wire.split_packets(self._buffer):
                if answered == kind and reply:
                    return reply
            self._fill()
        raise TimeoutError(f"no answer to RTDE packet {chr(kind)!r} within {REPLY_S:.0f} s")

    def _fill(self) -> None:
        chunk = self._link.recv(65536)
        if not chunk:
            raise ConnectionError("the controller closed the connection")
        self._buffer += chunk
