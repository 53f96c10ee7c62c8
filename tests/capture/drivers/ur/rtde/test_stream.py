"""One RTDE connection against a controller of a few lines that can misbehave."""

import socket
import struct
import threading
import time
from contextlib import contextmanager, suppress

import pytest

from koala3d.capture.drivers.ur.rtde import stream, wire
from koala3d.capture.drivers.ur.rtde.stream import RegistersInUse, RtdeStream
from koala3d.capture.drivers.ur.rtde.wire import Recipe, packet
from tests.moments import until

OUTPUTS = ["timestamp", "actual_q", "runtime_state"]
INPUTS = [["input_int_register_24"], ["input_double_register_24", "input_int_register_24"]]
REPLIES = {
    wire.PROTOCOL_VERSION: b"\x01",
    wire.OUTPUTS: b"\x01DOUBLE,VECTOR6D,UINT32",
    wire.INPUTS: b"\x01INT32",
    wire.START: b"\x01",
}


def _sample(timestamp):
    return packet(wire.DATA, b"\x01" + Recipe(OUTPUTS).pack([timestamp, range(6), 2]))


@contextmanager
def controller(monkeypatch, replies=None, after_start=b""):
    """Serves one connection; yields a list of the packets that it received and the means to end it."""
    listener = socket.create_server(("127.0.0.1", 0))
    monkeypatch.setattr(stream, "PORT", listener.getsockname()[1])
    silent = b"" in (replies or {}).values()
    monkeypatch.setattr(stream, "REPLY_S", 0.1 if silent else 20.0)
    answers, received, connection = {**REPLIES, **(replies or {})}, [], []

    def serve():
        link, _ = listener.accept()
        connection.append(link)
        with suppress(OSError):  # either side hangs up
            answer(link)

    def answer(link):
        buffer, inputs = bytearray(), 0
        while chunk := link.recv(4096):
            buffer += chunk
            for kind, payload in wire.split_packets(buffer):
                received.append((kind, payload))
                reply = answers.get(kind, b"")
                if kind == wire.INPUTS and reply == REPLIES[wire.INPUTS]:
                    inputs += 1
                    reply = bytes([inputs]) + ",".join(Recipe(payload.decode().split(",")).types).encode()
                if reply:
                    link.sendall(packet(ord("M"), b"a text message") + packet(kind, reply))
                if kind == wire.START:
                    link.sendall(after_start)

    server = threading.Thread(target=serve, daemon=True)
    server.start()
    try:
        yield received, connection
    finally:
        listener.close()
        for link in connection:
            link.close()


def _connect():
    return RtdeStream("127.0.0.1", OUTPUTS, INPUTS, 125.0)


def test_it_asks_for_its_variables_and_sends_numbered_inputs(monkeypatch):
    with controller(monkeypatch) as (received, _):
        link = _connect()
        link.send(2, [1.5, -3])
        until(lambda: received[-1][0] == wire.DATA, "the inputs at the controller")
        assert received[0] == (wire.PROTOCOL_VERSION, b"\x00\x02")
        assert received[1] == (wire.OUTPUTS, struct.pack(">d", 125.0) + b"timestamp,actual_q,runtime_state")
        assert received[-1] == (wire.DATA, b"\x02" + struct.pack(">di", 1.5, -3))
        link.close()


def test_the_newest_sample_is_taken_and_older_ones_are_dropped(monkeypatch):
    with controller(monkeypatch, after_start=b"".join(map(_sample, range(3000)))):  # more than one read takes
        link = _connect()
        sample, deadline = None, time.monotonic() + 2
        while (sample is None or sample["timestamp"] < 2999) and time.monotonic() < deadline:
            sample = link.newest(0.1) or sample
        assert sample == {"timestamp": 2999.0, "actual_q": [0, 1, 2, 3, 4, 5], "runtime_state": 2}
        assert link.newest() is None and link.connected
        link.close()


@pytest.mark.parametrize(
    ("replies", "error", "words"),
    [
        ({wire.PROTOCOL_VERSION: b"\x00"}, ConnectionError, "RTDE version 2"),
        ({wire.PROTOCOL_VERSION: b""}, TimeoutError, "no answer to RTDE packet 'V'|timed out"),
        ({wire.OUTPUTS: b"\x01DOUBLE,NOT_FOUND,UINT32"}, ConnectionError, "other variables: actual_q NOT_FOUND"),
        ({wire.OUTPUTS: b"\x01DOUBLE"}, ConnectionError, "other variables"),
        ({wire.INPUTS: b"\x00IN_USE"}, RegistersInUse, "another client"),
        ({wire.INPUTS: b"\x07INT32"}, ConnectionError, "numbers its input recipes 7"),
        ({wire.START: b"\x00"}, ConnectionError, "does not start"),
    ],
)
def test_a_controller_that_answers_otherwise_is_refused(monkeypatch, replies, error, words):
    with controller(monkeypatch, replies), pytest.raises(error, match=words):
        _connect()


@pytest.mark.parametrize("nonsense", [b"\x00\x02U", packet(wire.DATA, b"\x01short")])
def test_nonsense_closes_the_connection(monkeypatch, nonsense):
    with controller(monkeypatch, after_start=nonsense):
        link = _connect()
        assert link.newest(20.0) is None and not link.connected


def test_a_closed_connection_is_noticed_at_once_and_for_good(monkeypatch):
    with controller(monkeypatch, after_start=_sample(1.0)) as (_, connection):
        link = _connect()
        assert link.newest(20.0)
        connection[0].shutdown(socket.SHUT_RDWR)
        begun = time.monotonic()
        assert link.newest(60.0) is None and not link.connected
        assert time.monotonic() - begun < 6.0  # unnoticed it would take the sixty seconds
        link.send(1, [0])  # does nothing
        link.close()
