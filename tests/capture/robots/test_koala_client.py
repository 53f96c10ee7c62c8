"""Our own client against the simulated controller, without the driver around it."""

import time

import numpy as np
import pytest

from capture.robots import koala_client
from capture.robots.client import StartError, StartFailure
from capture.robots.koala_client import KoalaClient
from capture.sim.controller.process import SimulatedController

STEP = np.array([0.3, 0.1, -0.1, 0.2, 0.0, 0.1])


@pytest.fixture
def simulated():
    with SimulatedController.start(seed=3, time_scale=4.0) as found:
        yield found


@pytest.fixture
def client(simulated):
    found = KoalaClient(simulated.host, frequency=250.0, watchdog_hz=1.0)
    yield found
    found.leave()


def _until(client, happened, within_s=10.0):
    deadline = time.monotonic() + within_s
    while not happened(state := client.state()):
        assert time.monotonic() < deadline
        client.kick()
        time.sleep(0.005)
    return state


def test_motions_are_numbered_and_arrive(client):
    begun = client.state()
    assert begun["connected"] and begun["running"] and not begun["moving"]
    goal = np.array(begun["joints"]) + STEP
    assert client.move(goal.tolist(), 1.0, 1.4) == begun["operation"]
    moving = _until(client, lambda state: state["operation"] != begun["operation"])
    assert moving["operation"] == begun["operation"] + 1 and moving["moving"]
    ended = _until(client, lambda state: not state["moving"])
    np.testing.assert_allclose(ended["joints"], goal, atol=1e-3)  # it may swing for a moment


def test_stop_returns_at_once_and_a_new_motion_follows(client):
    start = np.array(client.state()["joints"])
    client.move((start + 5 * STEP).tolist(), 1.0, 1.4)
    _until(client, lambda state: max(map(abs, state["joint_speeds"])) > 0.2)
    begun = time.monotonic()
    client.stop(3.0)
    assert time.monotonic() - begun < 0.3
    _until(client, lambda state: not state["moving"] and max(map(abs, state["joint_speeds"])) < 0.01)
    assert client.move(start.tolist(), 1.0, 1.4) is not None


def test_without_kicks_the_watchdog_ends_the_program(client):
    deadline = time.monotonic() + 5
    while client.state()["running"]:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    begun = time.monotonic()
    assert client.move(client.state()["joints"], 1.0, 1.4) is None and time.monotonic() - begun < 0.5


def test_a_command_that_is_never_acknowledged_is_refused_in_time(client, simulated):
    simulated.ask("ignore_commands")
    begun = time.monotonic()
    assert client.move(client.state()["joints"], 1.0, 1.4) is None
    assert time.monotonic() - begun < 2 * koala_client.ANSWER_S + 0.5


def test_a_dropped_connection_is_reported_and_nothing_waits(client, simulated):
    simulated.ask("drop")
    state = _until(client, lambda state: not state["connected"])
    begun = time.monotonic()
    assert client.move(state["joints"], 1.0, 1.4) is None
    client.stop(3.0)
    assert client.tcp_offset() == []
    assert time.monotonic() - begun < 0.5


def test_a_second_client_is_refused(client, simulated):
    with pytest.raises(StartError, match="another client uses") as caught:
        KoalaClient(simulated.host, frequency=250.0, watchdog_hz=1.0)
    assert caught.value.failure is StartFailure.IN_USE


def test_a_stopped_arm_runs_no_program(simulated, monkeypatch):
    monkeypatch.setattr(koala_client, "START_S", 0.5)
    simulated.ask("protective_stop")
    with pytest.raises(StartError, match="the control program does not run"):
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
