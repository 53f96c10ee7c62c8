"""The simulated controller as a process: it starts, answers, and never outlives its parent."""

import asyncio
import errno
import os
import signal
import socket
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

from koala3d.capture.drivers.errors import SimulationError
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.kinematics import forward
from koala3d.capture.sim.controller import _child
from koala3d.capture.sim.controller.process import HOME, SimulatedController
from koala3d.datasets.core.errors import UsageError


def _accepts(host, port):
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex((host, port)) == 0


def test_ports_accept_while_it_lives_and_not_after():
    with SimulatedController.start() as simulated, SimulatedController.start() as other:
        assert simulated.host != other.host
        assert all(_accepts(simulated.host, port) for port in (30004, 30003, 29999))
        np.testing.assert_allclose(simulated.true_base_from_flange(), forward(HOME), atol=1e-3)
    assert not _accepts(simulated.host, 30004)
    with pytest.raises(SimulationError, match="does not answer"):
        simulated.true_base_from_flange()


@pytest.mark.parametrize(("model", "said"), [("ur7e", "UR7"), ("ur15", "UR15"), ("ur20", "UR20"), ("ur30", "UR30")])
def test_every_arm_of_the_family_has_its_controller(model, said):
    arm = load_arm(model)
    with SimulatedController.start(model=model, home=arm.home) as simulated:
        np.testing.assert_allclose(simulated.true_base_from_flange(), arm.forward(arm.home), atol=1e-3)
        with socket.create_connection((simulated.host, 29999), 5.0) as client:
            answers = client.makefile()
            assert "Dashboard Server" in answers.readline()
            client.sendall(b"get robot model\n")
            assert answers.readline().strip() == said


def test_an_arm_as_built_is_the_same_arm_with_the_same_links_seed():
    places = []
    for seed, links_seed in ((1, None), (1, 2), (3, 2)):
        with SimulatedController.as_built(seed=seed, links_seed=links_seed, time_scale=1.0) as simulated:
            places.append(simulated.true_base_from_flange()[:3, 3])
    away = np.linalg.norm(np.subtract(places, forward(HOME)[:3, 3]), axis=-1)
    assert (2e-4 < away).all() and (away < 1e-2).all()  # millimetres, a multiple of 0.05 degrees over 0.85 m
    assert np.linalg.norm(places[1] - places[2]) < 3e-4 < np.linalg.norm(places[0] - places[1])  # the arm's repeatability


@pytest.mark.parametrize("host", ["192.168.77.5", "0.0.0.0", "localhost", "nonsense", "::1"])
def test_it_listens_on_loopback_addresses_only(host):
    with pytest.raises(UsageError, match=r"no loopback address; give one of 127\.0\.0\.1 to"):
        SimulatedController.start(host=host)


def test_a_busy_port_is_reported():
    with SimulatedController.start() as simulated:
        with pytest.raises(
            SimulationError, match=rf"{simulated.host}.*30004, 30003, 29999, 30001, 30002 are not free there.*another --host"
        ):
            SimulatedController.start(host=simulated.host)


def test_a_computer_with_one_loopback_address_uses_that(monkeypatch):
    tried = []

    async def start_server(handler, host, port):
        tried.append(host)
        if host != "127.0.0.1":
            raise OSError(errno.EADDRNOTAVAIL, "not here")
        return SimpleNamespace(close=lambda: None, sockets=[SimpleNamespace(getsockname=lambda: (host, 4711))])

    monkeypatch.setattr(asyncio, "start_server", start_server)
    server = SimpleNamespace(serve_rtde=None, serve_script=None, serve_dashboard=None)
    assert asyncio.run(_child._listen(server, "")) == ("127.0.0.1", 4711)  # type: ignore[arg-type]
    assert len(set(tried)) > 10
    with pytest.raises(OSError, match="not here"):
        asyncio.run(_child._listen(server, "127.7.7.7"))  # type: ignore[arg-type]


def test_unknown_requests_name_the_known_ones():
    with SimulatedController.start() as simulated:
        with pytest.raises(SimulationError, match=r"'dance'.*actions: truth, motions, program, protective_stop"):
            simulated.ask("dance")
        assert simulated.ask("truth")["mode"] == "RUNNING"


def test_it_dies_with_its_parent():
    code = """if True:
        import time
        from koala3d.capture.sim.controller.process import SimulatedController
        started = SimulatedController.start()
        print(started.host, flush=True)
        time.sleep(60)
    """
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    host = parent.stdout.readline().strip()
    assert _accepts(host, 29999)
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 5
    while _accepts(host, 29999) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _accepts(host, 29999)


def test_strangers_on_the_ports_do_no_harm():
    with SimulatedController.start() as simulated:
        for port, words in ((30004, b"\x00\x01X"), (30004, b"\xff\xffU" + bytes(10)), (30003, b"def x"), (29999, b"\xff\n")):
            with socket.create_connection((simulated.host, port), 1.0) as stranger:
                stranger.sendall(words)
        assert simulated.ask("truth")["safety"] == "NORMAL"


def test_the_command_says_what_is_refused():
    host = "127.90.0.7" if sys.platform == "linux" else "127.0.0.1"
    command = [sys.executable, "-m", "koala3d.capture.cli", "sim", "--host", host]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        assert host in process.stdout.readline()
        with socket.create_connection((host, 30003), 5.0) as client:
            client.sendall(b"def program():\n  moveJ([0, 0, 0, 0, 0, 0])\nend\n")
            answer = client.makefile().readline().strip()
        assert answer == "line 2, column 3: there is no function 'moveJ'; did you mean 'movej'?"
        assert process.stderr.readline().strip().endswith(answer)
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 0
