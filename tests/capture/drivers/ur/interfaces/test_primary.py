"""Errors in programs, as the primary interface reports them."""

import socket
import struct

from koala3d.capture.drivers.ur.interfaces import primary
from koala3d.capture.sim.controller.process import SimulatedController
from tests.moments import until


def _controller_that_sends(data: bytes) -> "tuple[primary.Upload, socket.socket]":
    with socket.create_server(("127.77.0.1", primary.PORT)) as listener:
        upload = primary.Upload("127.77.0.1", "def program():\nend\n", 2.0)
        connection, _ = listener.accept()
    connection.sendall(data)
    return upload, connection


def _package(kind: int, content: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(content), kind) + content


def test_an_exception_is_found_among_other_packages_however_they_are_cut():
    """The layout of Universal Robots' client library: time, source, kind 10, line, column, text."""
    text = b"compile_error_name_not_found:calldoesntexist:"
    state = _package(16, _package(7, b"\x0a" * 20))
    message = _package(20, struct.pack(">QbbII", 12, -2, 7, 1, 2) + b"a key message")
    exception = _package(20, struct.pack(">Qbbii", 123, -2, 10, 2, 3) + text)
    data = state + message + exception + state
    upload, connection = _controller_that_sends(data[:60])
    with upload, connection:
        until(lambda: upload.refusal() == "" and len(upload._buffer) == 60 - len(state), "the first bytes")
        connection.sendall(data[60:])
        found: list[str] = []
        until(lambda: bool(found.append(upload.refusal()) or found[-1]), "the exception")
        assert found[-1] == f"line 2, column 3: {text.decode()}"


def test_every_listener_hears_of_a_program_that_came_over_another_port():
    with SimulatedController.start() as simulated, primary.Upload(simulated.host, "", 2.0) as listening:
        until(lambda: listening.refusal() == "" and listening._heard, "the controller's version")
        with socket.create_connection((simulated.host, 30003), 2.0) as script:
            script.sendall(b"def program():\n  halt()\nend\n")
            heard: list[str] = []
            until(lambda: bool(heard.append(listening.refusal()) or heard[-1]), "the exception")
    assert heard[-1] == "line 2, column 7: '(' in place of a name"
