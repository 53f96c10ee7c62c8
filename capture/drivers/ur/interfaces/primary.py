"""A UR controller's primary interface (port 30001): what it says of itself, and programs that it takes.

It says its version, the tool offset, its own kinematics and a checksum of its safety settings, and what is wrong with a program.
A package is int32 length, uint8 type, and for a robot state sub-packages of uint32 length, uint8 type (Universal Robots, "Client
interfaces"). All numbers are big-endian. The sub-package of the safety configuration is not documented; its first four bytes are
said to be the checksum. PolyScope X has this interface too, while it has no dashboard server.
"""

import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.kinematics import Links

PORT, WAIT_S = 30001, 1.5
STATE, MESSAGE = 16, 20
CARTESIAN, KINEMATICS, SAFETY = 4, 5, 10  # sub-packages of a state
VERSION, EXCEPTION = 3, 10  # kinds of message
CARTESIAN_FIELDS, KINEMATICS_FIELDS = struct.Struct(">12d"), struct.Struct(">6I24dI")
PLACE = struct.Struct(">ii")
"""Line and column of an exception, counted from 1; 0: it has none."""
MAX_PACKAGE = 1 << 16


@dataclass(frozen=True)
class Primary:
    """What has been heard; None: the controller did not say it."""

    version: tuple[int, int, int] | None = None
    tcp_offset: NDArray[np.float64] | None = None
    """(6,) position [m] and rotation vector [rad] of the tool in the flange."""
    links: Links | None = None
    """The controller's own, calibrated kinematics."""
    checksum: str | None = None
    """Of the safety configuration, hexadecimal."""

    @property
    def heard(self) -> bool:
        """Whether anything was said."""
        return self.version is not None or self.tcp_offset is not None

    @property
    def complete(self) -> bool:
        """Whether nothing is left to wait for."""
        return None not in (self.version, self.checksum) and self.tcp_offset is not None and self.links is not None


def listen(host: str, wait_s: float = WAIT_S) -> Primary:
    """What the controller says within a time. Raises OSError: nobody answers; ValueError: it is no primary interface."""
    heard, buffer, deadline = Primary(), bytearray(), time.monotonic() + wait_s
    with socket.create_connection((host, PORT), wait_s) as link:
        while not heard.complete and (left := deadline - time.monotonic()) > 0:
            link.settimeout(left)
            try:
                chunk = link.recv(65536)
            except TimeoutError:
                break
            if not chunk:
                break
            buffer += chunk
            for kind, payload in packages(buffer):
                heard = _learnt(heard, kind, payload)
    return heard


class Upload:
    """A program on its way to the controller, which runs it in place of any other and says if it does not compile.

    Raises OSError: nobody takes it.
    """

    def __init__(self, host: str, text: str, timeout_s: float) -> None:
        self._link, self._buffer, self._heard = socket.create_connection((host, PORT), timeout_s), bytearray(), False
        self._link.sendall(text.encode())
        self._link.setblocking(False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._link.close()

    def refusal(self) -> str:
        """What the controller has said against the program until now; empty: nothing. Raises OSError: it hung up silently."""
        try:
            while chunk := self._link.recv(65536):
                self._buffer += chunk
                self._heard = True
            if not self._heard:
                raise ConnectionResetError("the controller closed the connection")
        except BlockingIOError:
            pass  # nothing more has arrived
        except OSError:
            if not self._heard:
                raise
        found = [exception for kind, payload in packages(self._buffer) if (exception := _exception(kind, payload))]
        return found[0] if found else ""


def packages(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """(type, payload) of every complete package, removed from `buffer`; raises ValueError on an impossible length."""
    while len(buffer) >= 5:
        length, kind = struct.unpack_from(">iB", buffer)
        if not 5 <= length <= MAX_PACKAGE:
            raise ValueError(f"a package of {length} bytes")
        if len(buffer) < length:
            return
        payload = bytes(buffer[5:length])
        del buffer[:length]
        yield kind, payload


def package(kind: int, payload: bytes) -> bytes:
    """One package, or one sub-package."""
    return struct.pack(">iB", len(payload) + 5, kind) + payload


def _exception(kind: int, payload: bytes) -> str:
    """What a message says of an error in a program; empty for any other package."""
    if kind != MESSAGE or len(payload) < 10 + PLACE.size or payload[9] != EXCEPTION:
        return ""
    (line, column), text = PLACE.unpack_from(payload, 10), payload[10 + PLACE.size :].decode("latin-1").strip(" \0")
    return f"line {line}, column {column}: {text}" if line else text


def _learnt(heard: Primary, kind: int, payload: bytes) -> Primary:
    try:
        if kind == MESSAGE and len(payload) > 11 and payload[9] == VERSION:  # behind uint64 time and int8 source
            major, minor, bugfix = struct.unpack_from(">BBi", payload, 11 + payload[10])
            return replace(heard, version=(major, minor, bugfix))
        for part, content in packages(bytearray(payload)) if kind == STATE else ():
            heard = _part(heard, part, content)
    except struct.error as error:
        raise ValueError(f"a package of type {kind} is too short: {error}") from None
    return heard


def _part(heard: Primary, part: int, content: bytes) -> Primary:
    if part == CARTESIAN:
        return replace(heard, tcp_offset=np.array(CARTESIAN_FIELDS.unpack_from(content)[6:]))
    if part == KINEMATICS:
        theta, a, d, alpha = np.array(KINEMATICS_FIELDS.unpack_from(content)[6:30]).reshape(4, 6)
        return replace(heard, links=Links(d=d, a=a, alpha=alpha, theta=theta))
    if part == SAFETY and len(content) >= 4:
        return replace(heard, checksum=content[:4].hex())
    return heard
