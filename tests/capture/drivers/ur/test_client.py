"""Which client is taken, and what is said where it is missing."""

import sys

import numpy as np
import pytest

from koala3d.capture.drivers.errors import RigConnectionError
from koala3d.capture.drivers.ur import client, koala_client
from koala3d.capture.drivers.ur._child import open_client
from koala3d.capture.drivers.ur.client import StartError, StartFailure
from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.sim.controller.process import SimulatedController


@pytest.fixture
def opened(monkeypatch):
    """No connection is made: names of the clients that were opened."""
    names = []

    class Opened:
        kind = ""

        def __init__(self, *options, **more):
            names.append(self.kind)

    monkeypatch.setattr(koala_client, "KoalaClient", type("Koala", (Opened,), {"kind": "koala"}))
    vendor = type(sys)("koala3d.capture.drivers.ur.vendor_client")
    vendor.VendorClient = type("Vendor", (Opened,), {"kind": "ur_rtde"})
    monkeypatch.setitem(sys.modules, "koala3d.capture.drivers.ur.vendor_client", vendor)
    return names


@pytest.mark.parametrize(("choice", "taken"), [("auto", "ur_rtde"), ("ur_rtde", "ur_rtde"), ("koala", "koala")])
def test_the_vendors_client_is_the_default(opened, choice, taken):
    open_client(choice, "127.0.0.1", 125.0, 5.0, "lower")
    assert opened == [taken]


def test_without_it_ours_is_taken_or_the_reason_is_given(opened, monkeypatch):
    monkeypatch.setitem(sys.modules, "koala3d.capture.drivers.ur.vendor_client", None)
    open_client("auto", "127.0.0.1", 125.0, 5.0, "lower")
    assert opened == ["koala"]
    with pytest.raises(StartError, match="ur-rtde is not installed") as caught:
        open_client("ur_rtde", "127.0.0.1", 125.0, 5.0, "lower")
    assert caught.value.failure is StartFailure.MISSING


def test_the_driver_says_how_to_install_it(tmp_path, monkeypatch):
    (tmp_path / "rtde_control.py").write_text("raise ImportError('not here')\n")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{':'.join(filter(None, sys.path))}")
    with SimulatedController.start() as simulated:
        with pytest.raises(RigConnectionError, match=r"ur-rtde is not installed.*koala-capture\[robot\].*robot\.client: koala"):
            UniversalRobot(simulated.host, client="ur_rtde").__enter__()
        with UniversalRobot(simulated.host) as robot:
            assert robot.description()["client"] == client.versioned("koala", "koala-capture")


def test_a_client_is_named_with_its_version_where_that_is_known():
    assert client.versioned("numbers", "numpy") == f"numbers {np.__version__}"
    assert client.versioned("koala", "no-such-package-here") == "koala"


def test_an_unknown_client_is_refused():
    with pytest.raises(ValueError, match="'other' is not a valid ClientChoice"):
        UniversalRobot("127.0.0.1", client="other")
    assert [choice.value for choice in client.ClientChoice] == ["auto", "ur_rtde", "koala"]
