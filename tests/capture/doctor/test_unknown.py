"""What cannot be known is said to be unknown, and what contradicts or hides the rest is said once."""

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from koala3d.capture.doctor.examine import examine_arm
from koala3d.capture.doctor.lines import Line, Verdict
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.sim.controller.installation import Installation
from koala3d.capture.sim.controller.process import SimulatedController

PLAIN = Installation()
INSTALLED = {
    "serial": PLAIN.serial,
    "payload_kg": PLAIN.payload_kg,
    "payload_centre": PLAIN.payload_centre,
    "tool_offset": (0.0,) * 6,
    "safety_checksum": PLAIN.checksum,
}
RIG = RigDescription.model_validate({"robot": {"client": "ur_rtde", "installation": INSTALLED}})
GAP_S = 2.0  # a busy computer pauses for half a second


@pytest.fixture(scope="module")
def simulated() -> Iterator[SimulatedController]:
    with SimulatedController.as_built(seed=3, time_scale=1.0) as controller:
        yield controller


def examined(host: str, rig: RigDescription = RIG, **options: Any) -> list[Line]:
    settings = {"folder": Path(), "needed": 1.0, "seconds": 0.25, "longest_gap_s": GAP_S, "rate": None, **options}
    return examine_arm(host, rig, **settings)


def named(lines: list[Line], verdict: Verdict) -> set[str]:
    return {line.name for line in lines if line.verdict is verdict}


HIDDEN: dict[str, tuple[dict[str, Any], set[str], set[str]]] = {
    "no dashboard server": ({"dashboard": False}, {"dashboard"}, {"arm serial", "remote control"}),
    "primary interface blocked": (
        {"primary": False},
        set(),
        {"primary interface", "arm model", "own kinematics", "mounting", "tool offset", "safety checksum"},
    ),
    "no payload": ({"payload_kg": 0.0}, {"payload"}, {"centre of gravity"}),
    "nothing": ({}, set(), set()),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_what_a_fault_hides_is_unknown_with_a_remedy(simulated, name):
    install, wrong, unknown = HIDDEN[name]
    simulated.ask("install", **install)
    lines = examined(simulated.host)
    simulated.ask("install")
    assert (named(lines, Verdict.WRONG), named(lines, Verdict.UNKNOWN)) == (wrong, unknown)
    assert all(line.remedy for line in lines if line.verdict is not Verdict.OK)


def test_the_client_koala_needs_the_primary_interface(simulated):
    simulated.ask("install", primary=False)
    lines = examined(simulated.host, RigDescription.model_validate({"robot": {"client": "koala"}}))
    simulated.ask("install")
    assert named(lines, Verdict.WRONG) == {"primary interface"}


def test_what_the_rig_file_does_not_state_is_unknown_and_shown(simulated):
    lines = examined(simulated.host, RigDescription())
    assert named(lines, Verdict.WRONG) == set()
    shown = {line.name: line.remedy for line in lines if line.verdict is Verdict.UNKNOWN}
    assert shown.keys() == {"arm serial", "payload", "centre of gravity", "safety checksum"}
    assert "robot.installation.serial: '20235500001'" in shown["arm serial"]


def test_a_hanging_arm_is_right_where_the_session_or_the_rig_file_wants_one(simulated):
    simulated.ask("install", up=[0.0, 0.0, -1.0])
    ceiling = RigDescription.model_validate({"robot": {"installation": {**INSTALLED, "mounting": "ceiling"}}})
    wanted, stated, standing = examined(simulated.host, up=-1), examined(simulated.host, ceiling), examined(simulated.host)
    simulated.ask("install")
    assert named(wanted, Verdict.WRONG) == named(stated, Verdict.WRONG) == set()
    assert named(standing, Verdict.WRONG) == {"mounting"}


def test_a_clock_that_runs_at_another_rate_is_named():
    with SimulatedController.start(time_scale=2.0) as fast:
        lines = examined(fast.host, seconds=1.0, rate=1.0)
    assert named(lines, Verdict.WRONG) == {"controller clock"}


def test_a_controller_that_is_not_there_is_the_only_line():
    with socket.socket() as free:
        free.bind(("127.77.1.2", 0))
    (line,) = examined("127.77.1.2")
    assert (line.name, line.verdict) == ("controller", Verdict.WRONG) and "robot.host" in line.remedy
