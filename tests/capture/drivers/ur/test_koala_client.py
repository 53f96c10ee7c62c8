"""Our own client against the simulated controller, without the driver around it."""

import time

import numpy as np
import pytest

from koala3d.capture.drivers.ur import koala_client
from koala3d.capture.drivers.ur.client import StartError, StartFailure
from koala3d.capture.drivers.ur.koala_client import KoalaClient
from koala3d.capture.drivers.ur.rtde import program
from koala3d.capture.sim.controller.process import SimulatedController
from tests.moments import until

STEP = np.array([0.3, 0.1, -0.1, 0.2, 0.0, 0.1])


@pytest.fixture
def simulated():
    with SimulatedController.start(seed=3, time_scale=4.0) as found:
        yield found


@pytest.fixture
def client(simulated):
    found = KoalaClient(simulated.host, frequency=250.0, watchdog_hz=0.1)  # a busy computer may be late with a kick
    yield found
    found.leave()


def _waits(client, monkeypatch):
    """How long the client is ready to wait for a sample, each time from now on that it looks for one [s]."""
    waits, newest = [], client._stream.newest
    monkeypatch.setattr(client._stream, "newest", lambda wait_s=0.0: waits.append(wait_s) or newest(wait_s))
    return waits


def _until(client, happened):
    states = []

    def met():
        client.kick()
        states.append(client.state())
        return happened(states[-1])

    until(met, "a state of the arm")
    return states[-1]


def test_motions_are_numbered_and_arrive(client):
    begun = client.state()
    assert begun["connected"] and begun["running"] and not begun["moving"]
    goal = np.array(begun["joints"]) + STEP
    assert client.move(goal.tolist(), 0.1, 1.4) == begun["operation"]
    moving = _until(client, lambda state: state["operation"] != begun["operation"])
    assert moving["operation"] == begun["operation"] + 1 and moving["moving"]
    ended = _until(client, lambda state: not state["moving"])
    np.testing.assert_allclose(ended["joints"], goal, atol=1e-3)  # it may swing for a moment


def test_stop_returns_before_it_is_carried_out_and_a_new_motion_follows(client, simulated, monkeypatch):
    start = np.array(client.state()["joints"])
    client.move((start + 5 * STEP).tolist(), 1.0, 1.4)
    _until(client, lambda state: max(map(abs, state["joint_speeds"])) > 0.2)
    simulated.ask("ignore_commands")
    waits = _waits(client, monkeypatch)
    client.stop(3.0)
    assert not any(waits)
    simulated.ask("ignore_commands", ignore=False)
    _until(client, lambda state: not state["moving"] and max(map(abs, state["joint_speeds"])) < 0.01)
    assert client.move(start.tolist(), 1.0, 1.4) is not None


def test_without_kicks_the_watchdog_ends_the_program(simulated, monkeypatch):
    client = KoalaClient(simulated.host, frequency=250.0, watchdog_hz=2.0)
    until(lambda: not client.state()["running"], "the watchdog")
    waits = _waits(client, monkeypatch)
    assert client.move(client.state()["joints"], 1.0, 1.4) is None and not any(waits)
    client.leave()


def test_a_command_that_is_never_acknowledged_is_refused_in_time(client, simulated, monkeypatch):
    monkeypatch.setattr(koala_client, "ANSWER_S", 0.1)
    simulated.ask("ignore_commands")
    begun = time.monotonic()
    assert client.move(client.state()["joints"], 1.0, 1.4) is None
    assert time.monotonic() - begun < 10.0  # a hundred times what it is given; without a limit it would wait for ever
    simulated.ask("ignore_commands", ignore=False)


def test_a_dropped_connection_is_reported_and_nothing_waits(client, simulated, monkeypatch):
    simulated.ask("drop")
    state = _until(client, lambda state: not state["connected"])
    waits = _waits(client, monkeypatch)
    assert client.move(state["joints"], 1.0, 1.4) is None
    client.stop(3.0)
    assert client.tcp_offset() == []
    assert not any(waits)


def test_a_second_client_is_refused(client, simulated):
    with pytest.raises(StartError, match="another client uses") as caught:
        KoalaClient(simulated.host, frequency=250.0, watchdog_hz=1.0)
    assert caught.value.failure is StartFailure.IN_USE


def test_a_stopped_arm_runs_no_program(simulated, monkeypatch):
    monkeypatch.setattr(koala_client, "START_S", 0.5)
    simulated.ask("protective_stop")
    with pytest.raises(StartError, match="the control program does not run"):
        KoalaClient(simulated.host, frequency=250.0, watchdog_hz=1.0)


def test_a_program_that_does_not_compile_is_refused_in_the_controllers_words(simulated, monkeypatch):
    text = program.text().replace("come_to_rest", "halt")
    monkeypatch.setattr(koala_client.program, "text", lambda: text)
    refusal = r"refuses the control program: line \d+, column 7: 'halt' is a word of the language"
    with pytest.raises(StartError, match=refusal):
        KoalaClient(simulated.host, frequency=250.0, watchdog_hz=1.0)
    assert not simulated.ask("truth")["program_running"]


def test_a_closed_primary_interface_is_named(simulated):
    simulated.ask("install", primary=False)
    with pytest.raises(StartError, match=r"port 30001 takes no program: .*; open 'Primary/Secondary'"):
        KoalaClient(simulated.host, frequency=250.0, watchdog_hz=1.0)


def test_another_program_is_not_replaced(simulated, monkeypatch):
    first = KoalaClient(simulated.host, frequency=250.0, watchdog_hz=0.1)
    first._stream.close()  # the program runs on; its owner is gone
    monkeypatch.setattr(koala_client, "START_S", 0.5)
    with pytest.raises(StartError, match="another program runs on the controller"):
        KoalaClient(simulated.host, frequency=250.0, watchdog_hz=1.0)
    assert simulated.ask("truth")["program_running"]


def test_nobody_there():
    with pytest.raises(OSError):
        KoalaClient("127.9.9.9", frequency=250.0, watchdog_hz=1.0)
