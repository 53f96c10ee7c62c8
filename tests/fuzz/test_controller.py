"""Malformed, half-open and slow clients of the simulated controller: it stays up and small, and serves who behaves."""

import importlib.util
import socket
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from koala3d.capture.sim.controller.process import SimulatedController

ALL, SOME = 10_000, 300
BYTES = 50 * 2**20
"""By which the controller may grow."""
PATIENCE_S = 20.0
"""Within this the well-behaved client is answered, on however busy a computer."""
OPEN_AT_ONCE = 100


def _load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


clients = _load("clients")


@pytest.fixture
def controller() -> Iterator[SimulatedController]:
    with SimulatedController.start(time_scale=5.0) as started:
        yield started


def memory(controller: SimulatedController) -> int:
    """Resident memory of the controller's process [bytes]."""
    status = Path(f"/proc/{controller.process.pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmRSS"))


def check_alive(controller: SimulatedController, before: int) -> None:
    """The process runs, has not grown, and serves a client that begins now."""
    assert controller.process.poll() is None, f"the controller ended: {controller.last_line()}"
    late = clients.Connection(controller.host)
    assert late.check() < PATIENCE_S
    late.close()
    grown = memory(controller) - before
    assert grown < BYTES, f"the controller grew by {grown / 2**20:.0f} MB"


@pytest.mark.parametrize("count", [pytest.param(SOME, id="some"), pytest.param(ALL, id="all", marks=pytest.mark.slow)])
@pytest.mark.timeout(3600)
def test_malformed_messages(controller: SimulatedController, count: int) -> None:
    good, before = clients.Connection(controller.host), memory(controller)
    left_open: list[socket.socket] = []
    sent = number = 0
    while sent < count:
        try:
            sent += clients.misbehave(controller.host, number, left_open)
        except OSError as error:
            pytest.fail(f"connection {number} was not taken ({error}): {controller.last_line()}")
        number += 1
        while len(left_open) > OPEN_AT_ONCE:
            left_open.pop(0).close()
        if number % 20 == 0:
            assert controller.process.poll() is None, f"the controller ended at connection {number}: {controller.last_line()}"
            try:
                assert good.check() < PATIENCE_S, f"at connection {number}"
            except ConnectionError as error:
                pytest.fail(f"connection {number}: {error}; {controller.process.poll()} {controller.last_line()}")
    check_alive(controller, before)
    good.close()
    for one in left_open:
        one.close()


def test_a_hundred_connections_at_once_half_open_and_slow(controller: SimulatedController) -> None:
    good, before = clients.Connection(controller.host), memory(controller)
    ports = (clients.RTDE, clients.SCRIPT, clients.DASHBOARD)
    beginnings = {clients.RTDE: b"\x00\x50V", clients.SCRIPT: b"def p():\n", clients.DASHBOARD: b"robot"}
    opened = [
        (port, socket.create_connection((controller.host, port), PATIENCE_S))
        for port in ports
        for _ in range(OPEN_AT_ONCE // 3 + 1)
    ]
    for port, one in opened:
        one.sendall(beginnings[port][:1])
    for index in (1, 2):
        for port, one in opened:
            one.sendall(beginnings[port][index : index + 1])
        assert good.check() < PATIENCE_S
    check_alive(controller, before)
    for _, one in opened:
        one.close()
    good.close()


def test_a_client_that_never_reads_is_cut_off(controller: SimulatedController) -> None:
    good, before = clients.Connection(controller.host), memory(controller)
    for port, message in ((clients.DASHBOARD, (b"x" * 60_000 + b"\n") * 400), (clients.RTDE, clients.packet(ord("v")) * 300_000)):
        with socket.create_connection((controller.host, port), PATIENCE_S) as deaf:
            deaf.settimeout(2.0)
            try:
                for _ in range(5):
                    deaf.sendall(message)
            except OSError:
                continue  # cut off, or not listened to any more: both keep the controller small
            finally:
                assert good.check() < PATIENCE_S  # the controller has taken its turn with what was sent
                assert memory(controller) - before < BYTES
    check_alive(controller, before)
    good.close()


def test_a_program_without_an_end_is_refused(controller: SimulatedController) -> None:
    good, before = clients.Connection(controller.host), memory(controller)
    with socket.create_connection((controller.host, clients.SCRIPT), PATIENCE_S) as endless:
        endless.settimeout(5.0)
        try:
            for _ in range(64):
                endless.sendall(b"def p():\n" + b"  sync()\n" * 116_508)  # a megabyte
        except OSError:
            pass  # cut off
        else:
            pytest.fail("64 MB were taken for a program")
    check_alive(controller, before)
    good.close()
