"""Clients of the simulated controller: a well-behaved one, and malformed messages, each from its number alone."""

import random
import socket
import struct
import time
from collections.abc import Callable

RTDE, SCRIPT, DASHBOARD = 30004, 30003, 29999
DOUBLES = (0.0, -1.0, 1e-320, 1e300, -1e300, float("nan"), float("inf"), -float("inf"), 3.14, 1e5)
INTS = (0, 1, 2, 3, 4, 15, 28, 29, 30, 33, 35, 36, 37, 39, 40, 43, 46, 58, 60, 99, 254, 255, 256, -1, 2**31 - 1, -(2**31))
NAMES = (
    "timestamp",
    "actual_q",
    "input_int_register_0",
    "input_double_register_0",
    "input_int_register_24",
    "speed_slider_fraction",
    "standard_digital_output",
    "input_int_register_99",
    "",
    "nonsense",
    "a" * 500,
    "input_bit_register_127",
    "robot_mode",
)
ORDERS = (
    "running",
    "robotmode",
    "play",
    "pause",
    "stop",
    "power off",
    "power on",
    "brake release",
    "popup x",
    "load /etc/passwd",
    "shutdown",
    "unlock protective stop",
    "get serial number",
    "polyscopeversion",
    "safetymode",
    "quit",
    "",
    "close popup",
)


def packet(kind: int, payload: bytes = b"", size: int | None = None) -> bytes:
    """One framed packet; `size` instead of the true one."""
    return struct.pack(">HB", (len(payload) + 3 if size is None else size) & 0xFFFF, kind & 0xFF) + payload


class Connection:
    """A well-behaved client: what it asks is answered in time, or it raises."""

    def __init__(self, host: str, patience_s: float = 20.0) -> None:
        self.data = socket.create_connection((host, RTDE), patience_s)
        self.orders = socket.create_connection((host, DASHBOARD), patience_s)
        self._lines = self.orders.makefile("rb")
        assert b"Dashboard" in self._lines.readline()
        assert self.ask(ord("V"), struct.pack(">H", 2)) == b"\x01"
        assert self.ask(ord("O"), struct.pack(">d", 10.0) + b"timestamp,actual_q") == b"\x01DOUBLE,VECTOR6D"
        assert self.ask(ord("S")) == b"\x01"

    def ask(self, kind: int, payload: bytes = b"") -> bytes:
        """The answer to a packet."""
        self.data.sendall(packet(kind, payload))
        while True:
            found, answer = self._receive()
            if found == kind:
                return answer

    def _receive(self) -> tuple[int, bytes]:
        size, kind = struct.unpack(">HB", self._exactly(3))
        return kind, self._exactly(size - 3)

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            chunk = self.data.recv(count - len(data))
            if not chunk:
                raise ConnectionError("the controller closed a connection that did nothing wrong")
            data += chunk
        return data

    def check(self) -> float:
        """Receive two states with finite joints and increasing time, and a dashboard answer; returns the seconds it took."""
        begun, times = time.monotonic(), []
        while len(times) < 2:
            kind, payload = self._receive()
            if kind == ord("U"):
                values = struct.unpack(">d6d", payload[1:])
                assert all(value == value for value in values), f"the controller sends {values}"
                times.append(values[0])
        assert times[1] > times[0]
        self.orders.sendall(b"robotmode\n")
        answer = self._lines.readline()
        assert answer.startswith(b"Robotmode:"), answer
        return time.monotonic() - begun

    def close(self) -> None:
        """End both connections."""
        self.data.close()
        self._lines.close()
        self.orders.close()


def rtde_messages(choice: random.Random) -> list[bytes]:
    """What one connection sends to the data port."""
    messages = [packet(ord("V"), struct.pack(">H", choice.choice((0, 1, 2, 2, 2, 99, 65535))))]
    for _ in range(choice.randint(1, 4)):
        way = choice.randrange(7)
        if way == 0:
            messages.append(choice.randbytes(choice.choice((1, 2, 3, 50, 5000))))
        elif way == 1:
            messages.append(
                packet(choice.randrange(256), choice.randbytes(choice.randrange(100)), choice.choice((0, 1, 2, 3, 65535, None)))
            )
        elif way == 2:
            pool = choice.choice((NAMES, NAMES[:2]))  # any, or sound ones
            names = ",".join(choice.choices(pool, k=choice.choice((1, 3, 40, 2000, 7000))))
            messages.append(
                packet(
                    ord(choice.choice("OI")),
                    choice.choice((b"", struct.pack(">d", choice.choice(DOUBLES)))) + names.encode()[:65000],
                )
            )
        else:
            messages += _command(choice)
    return messages


def _command(choice: random.Random) -> list[bytes]:
    """Registers for the control program: any command with any numbers."""
    first = choice.choice((0, 24))
    names = [
        f"input_int_register_{first}",
        *(f"input_double_register_{first + index}" for index in range(12)),
        "speed_slider_mask",
        "speed_slider_fraction",
    ]
    values = struct.pack(
        ">i12dId",
        choice.choice((choice.choice(INTS), choice.randrange(80))),
        *(choice.choice(DOUBLES) for _ in range(12)),
        1,
        choice.choice(DOUBLES),
    )
    return [packet(ord("I"), ",".join(names).encode()), packet(ord("S")), *[packet(ord("U"), b"\x01" + values)] * 2]


def script_messages(choice: random.Random) -> list[bytes]:
    """What one connection sends to the script port."""
    way = choice.randrange(6)
    offset = choice.choice((0, 24, 47, 48, 99999999999999999999, -1, "x", ""))
    body = "\n".join(
        choice.choice(("  while True:", "  movej([0,0,0,0,0,0])", "  sync()", "end", "\t", "def g():", "é", "#", "  end"))
        for _ in range(choice.randrange(40))
    )
    if way == 0:
        return [choice.randbytes(choice.choice((1, 100, 70_000)))]
    if way == 1:
        return [f"movej([{choice.choice(DOUBLES)}]*6)\n".encode()]
    if way == 2:
        return [f"def program():\n{body}\nend\n".encode("latin-1")]
    if way == 3:
        return [f"def program():\n{body}".encode("latin-1")]
    if way == 4:
        return [bytes([letter]) for letter in b"def p():\nend\n"]
    return [f"def program():\n  # int register offset\n  reg_offset = {offset}\n{body}\nend\n".encode("latin-1")]


def dashboard_messages(choice: random.Random) -> list[bytes]:
    """What one connection sends to the dashboard."""
    way = choice.randrange(5)
    if way == 0:
        return [choice.randbytes(choice.choice((1, 100, 5000)))]
    if way == 1:
        return [b"x" * choice.choice((1000, 70_000))]
    if way == 2:
        return [(choice.choice(ORDERS) + "\n").encode() * choice.choice((1, 50))]
    if way == 3:
        return [f"{choice.choice(ORDERS)} {'é' * choice.randrange(200)}\r\n".encode()]
    return [b"\n" * 500, b"\0\xff\n", b"popup " + choice.randbytes(30) + b"\n"]


MESSAGES: tuple[tuple[int, Callable[[random.Random], list[bytes]]], ...] = (
    (RTDE, rtde_messages),
    (RTDE, rtde_messages),
    (SCRIPT, script_messages),
    (DASHBOARD, dashboard_messages),
)


def misbehave(host: str, number: int, left_open: list[socket.socket]) -> int:
    """One connection that sends what it should not; returns the number of messages sent."""
    choice, sent = random.Random(number), 0
    port, messages = choice.choice(MESSAGES)
    with_socket = socket.create_connection((host, port), 20)
    try:
        for message in messages(choice):
            with_socket.sendall(message)
            sent += 1
        ending = choice.randrange(4)
        if ending == 0:
            with_socket.shutdown(socket.SHUT_WR)
        elif ending == 1:  # reset instead of an end
            with_socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        elif ending == 2:
            left_open.append(with_socket)
            return sent
    except OSError:
        pass  # the controller closed it, as it may
    with_socket.close()
    return sent
