"""A line to a device that speaks lines of text: a serial port, or a network connection to one. The standard library is enough."""

import os
import select
import socket
import threading
import time

from koala3d.capture.drivers.errors import RigConnectionError

CONNECT_S = 5.0
LONGEST = 4096  # bytes without a newline after which the other end is taken to speak something else


class Wire:
    """Bytes out, lines in. `open` connects or leaves nothing open; `close` may be called twice.

    Args:
        address: path of a serial port or pseudo-terminal; or host:port.
        baud: bits per second of a serial port.
    """

    def __init__(self, address: str, baud: int) -> None:
        self.address, self.baud = address, baud
        self._socket: socket.socket | None = None
        self._descriptor, self._kept = -1, b""
        self._writing = threading.Lock()

    def open(self) -> None:
        """Connect; raises RigConnectionError with what was found at the address."""
        host, _, port = self.address.rpartition(":")
        network = bool(host) and port.isdigit() and not os.path.exists(self.address)
        try:
            if network:
                self._socket = socket.create_connection((host, int(port)), timeout=CONNECT_S)
                self._socket.setblocking(False)
                self._descriptor = self._socket.fileno()
            else:
                self._descriptor = os.open(self.address, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                _raw(self._descriptor, self.baud)
        except (OSError, ValueError) as error:
            self.close()
            remedy = "check the cable, the address and the permission to use the port; turntable.address in the rig file"
            raise RigConnectionError(
                "no connection to the turntable", where=self.address, why=str(error), remedy=remedy
            ) from None
        self._kept = b""

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None:
            self._socket.close()
        elif self._descriptor >= 0:
            os.close(self._descriptor)
        self._socket, self._descriptor = None, -1

    def send(self, data: bytes) -> None:
        """Write all of it; may be called from another thread. Raises RigConnectionError."""
        with self._writing:
            try:
                while data:
                    if not select.select([], [self._descriptor], [], CONNECT_S)[1]:
                        raise TimeoutError("nothing is accepted")
                    data = data[os.write(self._descriptor, data) :]
            except (OSError, ValueError) as error:
                raise self._lost(str(error)) from None

    def line(self, timeout_s: float) -> str | None:
        """The next line that is not empty, without its end; None if none comes in time. Raises RigConnectionError."""
        deadline = time.monotonic() + timeout_s
        while True:
            first, newline, rest = self._kept.partition(b"\n")
            if newline:
                self._kept = rest
                if text := first.decode("ascii", "replace").strip():
                    return text
                continue
            if len(self._kept) > LONGEST:
                raise self._lost("it speaks no lines")
            left = deadline - time.monotonic()
            try:
                if left <= 0 or not select.select([self._descriptor], [], [], left)[0]:
                    return None
                data = os.read(self._descriptor, LONGEST)
            except (OSError, ValueError) as error:
                raise self._lost(str(error)) from None
            if not data:
                raise self._lost("it hung up")
            self._kept += data

    def _lost(self, why: str) -> RigConnectionError:
        remedy = "check cable and power; the same command with --resume continues"
        return RigConnectionError("the connection to the turntable was lost", where=self.address, why=why, remedy=remedy)


def _raw(descriptor: int, baud: int) -> None:
    """Set a serial port to plain bytes of 8 bits. Raises OSError where it is none, ValueError for an impossible speed."""
    try:
        import termios
        import tty
    except ImportError:  # Windows
        raise OSError("serial ports are supported on Linux and macOS only; use host:port") from None
    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        raise ValueError(f"the system has no serial speed of {baud}")
    try:
        tty.setraw(descriptor)
        settings = termios.tcgetattr(descriptor)
        settings[2] = (settings[2] | termios.CLOCAL | termios.CREAD) & ~termios.HUPCL
        settings[4] = settings[5] = speed
        termios.tcsetattr(descriptor, termios.TCSANOW, settings)
    except termios.error as error:
        raise OSError(f"it is not a serial port: {error}") from None
