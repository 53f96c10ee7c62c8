"""A rig in order has nothing wrong; each of the seeded faults is named, and nothing else."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from koala3d.capture.doctor.camera import check
from koala3d.capture.doctor.examine import examine_arm, refuse_wrong
from koala3d.capture.doctor.lines import Line, Verdict
from koala3d.capture.drivers.cameras.basler import Basler
from koala3d.capture.drivers.errors import NotReady
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.capture.sim.camera_nodes import FAMILIES, Setting, SimulatedNodes
from koala3d.capture.sim.controller.process import SimulatedController

STATED = {
    "serial": "20235500001",
    "payload_kg": 0.5,
    "payload_centre": [0.0, 0.03, 0.05],
    "tool_offset": [0.0] * 6,
    "safety_checksum": "5afe0011",
}
GAP_S = 1.0  # a busy computer pauses for half a second
NOW = datetime(2026, 11, 25, tzinfo=UTC)
TILTED = [0.0, float(np.sin(0.2)), float(np.cos(0.2))]


@dataclass(frozen=True)
class Fault:
    """What is done to the rig, and the line that must be wrong. Faults of one `part` exclude each other."""

    line: str
    part: str
    install: dict[str, Any] = field(default_factory=dict)
    safety: dict[str, str] = field(default_factory=dict)
    slider: float = 1.0
    camera: dict[str, Setting] = field(default_factory=dict)
    without: tuple[str, ...] = ()
    asked: dict[str, Any] = field(default_factory=dict)
    stated_camera: dict[str, str] = field(default_factory=dict)


FAULTS = {
    "a UR3e": Fault("arm model", "model", {"model": "ur3e"}),
    "a UR10e": Fault("arm model", "model", {"model": "ur10e"}),
    "a UR16e": Fault("arm model", "model", {"model": "ur16e"}),
    "a UR20": Fault("arm model", "model", {"model": "ur20"}),
    "another arm of the model": Fault("arm serial", "serial", {"serial": "20235500002"}),
    "old software": Fault("software", "version", {"version": [5, 4, 0, 1]}),
    "another calibration": Fault("own kinematics", "model", {"calibrated": False}),
    "another tool orientation": Fault("tool offset", "tcp", {"tcp": [0.0, 0.0, 0.0, 0.0, 0.5, 0.0]}),
    "local control": Fault("remote control", "remote", {"remote": False}),
    "a program runs": Fault("program", "program", {"program": "PLAYING"}),
    "a program is paused": Fault("program", "program", {"program": "PAUSED"}),
    "no payload": Fault("payload", "payload", {"payload_kg": 0.0}),
    "another payload": Fault("payload", "payload", {"payload_kg": 0.8}),
    "another centre of gravity": Fault("centre of gravity", "payload", {"payload_centre": [0.0, 0.0, 0.1]}),
    "it hangs": Fault("mounting", "up", {"up": [0.0, 0.0, -1.0]}),
    "it is tilted": Fault("mounting", "up", {"up": TILTED}),
    "another tool": Fault("tool offset", "tcp", {"tcp": [0.0, 0.0, 0.15, 0.0, 0.0, 0.0]}),
    "other safety settings": Fault("safety checksum", "checksum", {"checksum": "00c0ffee"}),
    "protective stop": Fault("safety mode", "safety", safety={"mode": "PROTECTIVE_STOP"}),
    "emergency stop": Fault("safety mode", "safety", safety={"mode": "ROBOT_EMERGENCY_STOP", "power": "POWER_OFF"}),
    "automatic-mode safeguard": Fault("safeguard stop", "safety", safety={"mode": "AUTOMATIC_MODE_SAFEGUARD_STOP"}),
    "enabling switch": Fault("safeguard stop", "safety", safety={"mode": "TP_THREE_POSITION_ENABLING_STOP"}),
    "safety API": Fault("safeguard stop", "safety", safety={"mode": "SAFETY_API_SAFEGUARD_STOP"}),
    "PROFIsafe waits": Fault("safety mode", "safety", safety={"mode": "PROFISAFE_WAITING_FOR_PARAMETERS"}),
    "safeguard stop": Fault("safeguard stop", "safety", safety={"mode": "SAFEGUARD_STOP"}),
    "reduced mode": Fault("reduced mode", "safety", safety={"mode": "REDUCED"}),
    "brakes on": Fault("power", "safety", safety={"power": "IDLE"}),
    "power off": Fault("power", "safety", safety={"power": "POWER_OFF"}),
    "slider": Fault("speed slider", "slider", slider=0.25),
    "a network that stalls": Fault("network", "network", {"latency_s": 3.0}),
    "a full disk": Fault("free disk", "disk", asked={"needed": 1e18}),
    "a clock that was reset": Fault("clock", "clock", asked={"now": lambda: datetime(1970, 1, 1, tzinfo=UTC)}),
    "another camera": Fault("camera serial", "camera", stated_camera={"serial": "24000001"}),
    "other firmware": Fault("camera firmware", "firmware", stated_camera={"firmware": "9.9"}),
    "USB 2": Fault("camera link", "link", camera={"DeviceLinkSpeed": Setting(60_000_000)}),
    "a hot camera": Fault("camera temperature", "heat", camera={"DeviceTemperature": Setting(92.0)}),
    "no factory settings": Fault("factory settings", "default", without=("UserSetLoad",)),
    "a picture that stays reversed": Fault("camera settings", "settings", camera={"ReverseX": Setting(True, stuck=True)}),
    "a black level that stays": Fault("camera settings", "settings", camera={"BlackLevel": Setting(8.0, stuck=True)}),
    "a gamma that stays": Fault("camera settings", "settings", camera={"Gamma": Setting(0.4, stuck=True)}),
    "a preset that brings its own gamma": Fault(
        "camera settings", "settings", camera={"LightSourcePreset": Setting("Daylight5000K", ("Daylight5000K",))}
    ),
    "a camera without sRGB": Fault("colour space", "colours", without=("ColorSpace",)),
    "a colour space that stays linear": Fault(
        "colour space", "colours", camera={"ColorSpace": Setting("RGB", ("RGB", "sRGB"), stuck=True)}
    ),
}


@pytest.fixture(scope="module")
def controller() -> Iterator[SimulatedController]:
    with SimulatedController.as_built(seed=2, time_scale=20.0) as found:
        yield found


@pytest.fixture(scope="module")
def emulation() -> Iterator[tuple[Any, str]]:
    with Basler(CameraSettings(), emulated=True).inspected() as found:
        yield found.nodes, found.serial


def examine(controller: SimulatedController, emulation: Any, faults: list[Fault], folder: Path) -> list[Line]:
    """Strike with the faults, ask the doctor, and mend."""
    together: dict[str, Any] = {key: {} for key in ("install", "safety", "camera", "asked", "stated_camera")}
    for fault in faults:
        for key, values in together.items():
            values.update(getattr(fault, key))
    nodes, serial = emulation
    stated = {"serial": serial, "firmware": nodes.read("DeviceFirmwareVersion"), **together["stated_camera"]}
    description = RigDescription.model_validate({"robot": {"installation": STATED}, "camera": stated})
    try:
        controller.ask("install", **together["install"])
        controller.ask("safety", **together["safety"])
        controller.ask("speed_slider", fraction=min([1.0, *(fault.slider for fault in faults)]))
        own = {"needed": 1e6, "now": lambda: NOW, **together["asked"]}
        seconds = 1.2 if "latency_s" in together["install"] else 0.05
        lines = examine_arm(controller.host, description, folder=folder, seconds=seconds, longest_gap_s=GAP_S, rate=None, **own)
        without = [name for fault in faults for name in fault.without]
        over = SimulatedNodes(nodes, "ace USB", without=without, changed=together["camera"])
        return [*lines, *check(over, serial, {}, description.camera, genicam=True)]
    finally:
        controller.ask("install")
        controller.ask("safety")
        controller.ask("speed_slider", fraction=1.0)


def named(lines: list[Line]) -> list[str]:
    return [line.name for line in lines if line.verdict is Verdict.WRONG]


def test_there_are_enough_faults():
    assert len(FAULTS) >= 25


def test_a_rig_in_order_is_ok_in_every_line(controller, emulation, tmp_path):
    lines = examine(controller, emulation, [], tmp_path)
    assert [line for line in lines if line.verdict is not Verdict.OK] == []
    refuse_wrong(lines, "here")


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_and_nothing_else(controller, emulation, tmp_path, name):
    lines = examine(controller, emulation, [FAULTS[name]], tmp_path)
    assert named(lines) == [FAULTS[name].line]
    (line,) = [line for line in lines if line.verdict is Verdict.WRONG]
    assert line.found and line.remedy
    if line.blocks:
        with pytest.raises(NotReady, match="the rig is not ready"):
            refuse_wrong(lines, controller.host)


@pytest.mark.parametrize("seed", range(4))
def test_several_faults_are_all_named(controller, emulation, tmp_path, seed):
    rng = np.random.default_rng(seed)
    by_part = {FAULTS[name].part: FAULTS[name] for name in rng.permutation(list(FAULTS))}
    chosen = [by_part[part] for part in rng.permutation(sorted(by_part))[:6]]
    assert sorted(named(examine(controller, emulation, chosen, tmp_path))) == sorted(fault.line for fault in chosen)


def test_polyscope_x_has_no_dashboard_and_needs_none(controller, emulation, tmp_path):
    """Without one nobody says who has control; all else is still found out."""
    polyscope_x = Fault("dashboard", "dashboard", {"dashboard": False, "version": [10, 7, 0, 0]})
    lines = {line.name: line for line in examine(controller, emulation, [polyscope_x], tmp_path)}
    assert named(list(lines.values())) == [] and "PolyScope X" in lines["dashboard"].found
    assert lines["remote control"].verdict is Verdict.UNKNOWN
    assert lines["software"].found == "10.7.0" and lines["program"].verdict is Verdict.OK


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_is_brought_to_srgb_by_its_own_name(emulation, family):
    nodes, serial = emulation
    over = SimulatedNodes(nodes, family)
    assert named(check(over, serial, {}, RigDescription().camera, genicam=True)) == []
    names = {"ace USB": "ColorSpace", "ace 2": "BslColorSpace", "dart": "BslColorSpaceMode", "ace GigE": "GammaSelector"}
    assert over.read(names[family]).lower() == "srgb"
    assert family != "ace GigE" or over.read("GammaEnable") is True
