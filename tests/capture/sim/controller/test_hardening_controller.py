"""The simulated controller answers as the real one does, or says that it cannot."""

import logging
import socket
import struct
import time
from collections.abc import Iterator

import numpy as np
import pytest

from koala3d.capture.drivers.ur.rtde import program
from koala3d.capture.drivers.ur.rtde.wire import packet
from koala3d.capture.sim.controller.commands.table import ACTIONS, ANSWERS, CALLS
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.capture.sim.controller.script import DONE, ControlProgram, check
from koala3d.capture.sim.controller.urscript.lexer import ScriptError
from tests.moments import until

HOME = np.array([0, -np.pi / 2, 0, -np.pi / 2, 0, 0])
UNKNOWN = [number for number in range(1, 100) if number not in ACTIONS and number not in ANSWERS]
"""Commands of the client that the simulation does not carry out: those of forces and masses, and unused numbers."""


@pytest.fixture(scope="module")
def controller() -> Iterator[SimulatedController]:
    """Hears a stranger in every test, and goes on."""
    with SimulatedController.start() as started:
        yield started


def received(connection: socket.socket, kind: int) -> bytes:
    """Payload of the next packet, which must be of a kind."""
    size, found = struct.unpack(">HB", connection.recv(3, socket.MSG_WAITALL))
    assert found == kind
    return connection.recv(size - 3, socket.MSG_WAITALL) if size > 3 else b""


@pytest.mark.parametrize("version", [0, 3, 99])
def test_a_protocol_version_that_does_not_exist_is_not_accepted(controller: SimulatedController, version: int) -> None:
    with socket.create_connection((controller.host, 30004), 10) as client:
        client.sendall(packet(ord("V"), struct.pack(">H", version)))
        assert received(client, ord("V")) == b"\x00"
        client.sendall(packet(ord("V"), struct.pack(">H", 2)))  # another one may be asked for
        assert received(client, ord("V")) == b"\x01"


def test_protocol_version_1_has_neither_frequencies_nor_recipe_numbers(controller: SimulatedController) -> None:
    """Universal Robots, "Real-Time Data Exchange guide": in version 1 a recipe is names alone, and data are values alone."""
    with socket.create_connection((controller.host, 30004), 10) as client:
        client.sendall(packet(ord("V"), struct.pack(">H", 1)))
        assert received(client, ord("V")) == b"\x01"
        client.sendall(packet(ord("O"), b"timestamp,robot_mode"))
        assert received(client, ord("O")) == b"DOUBLE,INT32"
        client.sendall(packet(ord("S")))
        assert received(client, ord("S")) == b"\x01"
        timestamp, mode = struct.unpack(">di", received(client, ord("U")))
        assert timestamp > 0 and mode == 7


def test_the_premise_there_are_commands_that_are_not_simulated() -> None:
    assert len(UNKNOWN) > 20 and set(UNKNOWN) >= {5, 6, 7, 12, 13, 14}


@pytest.mark.parametrize("number", UNKNOWN[::6])
def test_an_unknown_command_ends_the_program_with_the_reason(number: int, caplog: pytest.LogCaptureFixture) -> None:
    control = ControlProgram(SimulatedArm(0, HOME, 0.0, 0.0), "def rtde_control():\nend\n")
    control.input_ints[0] = number
    with caplog.at_level(logging.WARNING):
        control.cycle(0.0)
    assert not control.running and control.output_ints[0] != DONE
    name = f"{CALLS[number]} (command {number})" if number in CALLS else f"command {number}"
    assert f"{name} is not simulated" in caplog.text


def test_an_output_cannot_be_an_input(controller: SimulatedController) -> None:
    with socket.create_connection((controller.host, 30004), 10) as client:
        client.sendall(packet(ord("V"), struct.pack(">H", 2)))
        assert received(client, ord("V")) == b"\x01"
        client.sendall(packet(ord("I"), b"output_int_register_3,actual_q"))
        assert received(client, ord("I")) == b"\x00NOT_FOUND,NOT_FOUND"


@pytest.mark.parametrize("line", ["movej([0,-1.2,0,-1.5,0,0], a=1.4, v=1.0)\n", "movej([0,-1.2,0,-1.5,0,0])"])
def test_a_program_of_one_line_is_executed_or_refused(controller: SimulatedController, line: str) -> None:
    with socket.create_connection((controller.host, 30003), 10) as client:
        client.sendall(line.encode())
        if not line.endswith("\n"):
            client.shutdown(socket.SHUT_WR)
        client.settimeout(0.05)
        deadline = time.monotonic() + 3
        while time.monotonic() < deadline:
            if controller.ask("truth")["moving"]:
                return
            try:
                refused = client.recv(4096)
            except TimeoutError:
                continue
            if line.endswith("\n") or refused:
                return  # closed, or told why
            break
        pytest.fail("the line was neither executed nor refused")


@pytest.mark.parametrize("offset", [47, 99, "9" * 5000])
def test_a_program_with_an_impossible_register_offset_does_not_end_the_controller(
    controller: SimulatedController, offset: int | str
) -> None:
    text = f"def program():\n  # int register offset\n  reg_offset = {offset}\n  sync()\nend\n"
    with socket.create_connection((controller.host, 30003), 10) as client:
        client.sendall(text.encode())
        client.makefile("rb").read()  # until the controller hangs up on what it refuses
    assert controller.process.poll() is None, controller.last_line()
    controller.ask("truth")


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("offset = 47", "registers from 47 on"),
        ("offset = 0\n  write_output_integer_register(48, 1)", "integer register 48"),
        ("offset = 24\n  x = read_input_boolean_register(64)", "boolean register 64"),
    ],
)
def test_a_program_with_registers_that_are_not_simulated_is_refused(line: str, why: str) -> None:
    with pytest.raises(ScriptError, match=why):
        check(f"def program():\n  # int register offset\n  {line}\nend\n")


def test_our_program_is_taken_and_others_are_not() -> None:
    check(program.text())
    with pytest.raises(ScriptError, match="other than the control program"):
        check("def program():\n  movej([0, 0, 0, 0, 0, 0])\nend\n")


@pytest.mark.parametrize("version", [1, 2])
def test_clients_are_told_why_a_program_was_refused(controller: SimulatedController, version: int) -> None:
    with socket.create_connection((controller.host, 30004), 10) as client:
        client.sendall(packet(ord("V"), struct.pack(">H", version)))
        assert received(client, ord("V")) == b"\x01"
        with socket.create_connection((controller.host, 30003), 10) as sender:
            sender.sendall(b"movej([0, 0, 0, 0, 0, 0])\n")
            line = sender.makefile("rb").readline().rstrip()
        message = received(client, ord("M"))
        start, end = (1, None) if version == 1 else (1, 1 + message[0])
        assert message[start:end] == line and b"a program begins with 'def'" in line
        assert line.decode() == controller.last_line()


def test_the_vendors_client_sees_an_ended_program_and_starts_again() -> None:
    wheel = "ur-rtde is not installed: it has no wheel for this Python and platform"
    rtde_control, rtde_io = (pytest.importorskip(name, reason=wheel) for name in ("rtde_control", "rtde_io"))
    with SimulatedController.start() as controller:
        client, outputs = rtde_control.RTDEControlInterface(controller.host), rtde_io.RTDEIOInterface(controller.host)
        home = controller.ask("truth")["joints"]
        assert client.moveJ(home, 1.0, 1.4) and outputs.setStandardDigitalOut(1, True) and client.isProgramRunning()
        assert not client.forceModeSetDamping(0.1) and not client.isProgramRunning()
        assert controller.last_line() == "the program was ended: forceModeSetDamping (command 20) is not simulated"
        assert client.reuploadScript()
        until(client.isProgramRunning, "a program that runs")
        assert client.moveJ(home, 1.0, 1.4)
        client.setExternalForceTorque([0.0] * 6)  # the client mistakes the recipe, and does not notice
        ignored = "a packet was ignored: 52 bytes where the recipe has 56: input_int_register_0"
        until(lambda: controller.last_line().startswith(ignored), "a line about it")
        client.disconnect()
