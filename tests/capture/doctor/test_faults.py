"""A rig in order has nothing wrong; each of the seeded faults is named, and nothing else."""

import os
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
from koala3d.capture.drivers.cameras.start_state import set_colour_space
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
    noise_rad: float = 4e-6
    silent: bool = False
    camera: dict[str, Setting] = field(default_factory=dict)
    without: tuple[str, ...] = ()
    asked: dict[str, Any] = field(default_factory=dict)
    stated_camera: dict[str, str] = field(default_factory=dict)
    robot: dict[str, Any] = field(default_factory=dict)  # what the rig file says of it
    checked: dict[str, Any] = field(default_factory=dict)  # how the computer serves the camera
    hides: tuple[str, ...] = ()  # lines that nothing can be said about then


WITHOUT_SAMPLES = (
    "arm model", "own kinematics", "mounting", "noise at rest", "payload", "centre of gravity", "power", "safety mode",
    "safeguard stop", "reduced mode", "speed slider", "network", "controller clock",
    "tool offset", "safety checksum",
)  # fmt: skip
WITHOUT_PRIMARY = ("arm model", "own kinematics", "mounting", "tool offset", "safety checksum")
STOPPED = ("safeguard stop",)
GUARDED = ("safety mode",)
API = pytest.mark.skipif(os.geteuid() != 0, reason="the Robot API has port 80, which only root may open")
POLYSCOPE_X: dict[str, Any] = {"dashboard": False, "version": [10, 14, 0, 0]}
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
    "no payload": Fault("payload", "payload", {"payload_kg": 0.0}, hides=("centre of gravity",)),
    "another payload": Fault("payload", "payload", {"payload_kg": 0.8}),
    "another centre of gravity": Fault("centre of gravity", "payload", {"payload_centre": [0.0, 0.0, 0.1]}),
    "it hangs": Fault("mounting", "up", {"up": [0.0, 0.0, -1.0]}),
    "it is tilted": Fault("mounting", "up", {"up": TILTED}),
    "another tool": Fault("tool offset", "tcp", {"tcp": [0.0, 0.0, 0.15, 0.0, 0.0, 0.0]}),
    "other safety settings": Fault("safety checksum", "checksum", {"checksum": "00c0ffee"}),
    "protective stop": Fault("safety mode", "safety", safety={"mode": "PROTECTIVE_STOP"}, hides=STOPPED),
    "emergency stop": Fault(
        "safety mode", "safety", safety={"mode": "ROBOT_EMERGENCY_STOP", "power": "POWER_OFF"}, hides=(*STOPPED, "power")
    ),
    "automatic-mode safeguard": Fault(
        "safeguard stop", "safety", safety={"mode": "AUTOMATIC_MODE_SAFEGUARD_STOP"}, hides=GUARDED
    ),
    "enabling switch": Fault("safeguard stop", "safety", safety={"mode": "TP_THREE_POSITION_ENABLING_STOP"}, hides=GUARDED),
    "safety API": Fault("safeguard stop", "safety", safety={"mode": "SAFETY_API_SAFEGUARD_STOP"}, hides=GUARDED),
    "PROFIsafe waits": Fault("safety mode", "safety", safety={"mode": "PROFISAFE_WAITING_FOR_PARAMETERS"}, hides=STOPPED),
    "safeguard stop": Fault("safeguard stop", "safety", safety={"mode": "SAFEGUARD_STOP"}, hides=GUARDED),
    "reduced mode": Fault("reduced mode", "safety", safety={"mode": "REDUCED"}),
    "brakes on": Fault("power", "safety", safety={"power": "IDLE"}),
    "power off": Fault("power", "safety", safety={"power": "POWER_OFF"}),
    "slider": Fault("speed slider", "slider", slider=0.25),
    "a network that stalls": Fault("network", "network", {"latency_s": 3.0}, hides=("noise at rest",)),
    "another arm in the rig file": Fault("arm model", "model", robot={"model": "ur10e"}),
    "another mounting in the rig file": Fault("mounting", "up", robot={"installation": {**STATED, "mounting": "ceiling"}}),
    "another payload in the rig file": Fault("payload", "payload", robot={"installation": {**STATED, "payload_kg": 0.9}}),
    "another checksum in the rig file": Fault(
        "safety checksum", "checksum", robot={"installation": {**STATED, "safety_checksum": "12345678"}}
    ),
    "encoders that rattle": Fault("noise at rest", "noise", noise_rad=2e-4),
    "no dashboard on PolyScope 5": Fault("dashboard", "dashboard", {"dashboard": False}, hides=("arm serial", "remote control")),
    "no samples": Fault("RTDE", "rtde", silent=True, hides=WITHOUT_SAMPLES),
    "no primary interface for the client koala": Fault(
        "primary interface", "primary", {"primary": False}, robot={"client": "koala"}, hides=WITHOUT_PRIMARY
    ),
    "a system emergency stop": Fault("safety mode", "safety", safety={"mode": "SYSTEM_EMERGENCY_STOP"}, hides=STOPPED),
    "a violation": Fault("safety mode", "safety", safety={"mode": "VIOLATION"}, hides=STOPPED),
    "a fault of the safety system": Fault("safety mode", "safety", safety={"mode": "FAULT"}, hides=STOPPED),
    "recovery mode": Fault("safety mode", "safety", safety={"mode": "RECOVERY"}, hides=STOPPED),
    "still booting": Fault("power", "safety", safety={"power": "BOOTING"}),
    "PolyScope X in local control": Fault("remote control", "remote", {**POLYSCOPE_X, "remote": False}),
    "PolyScope X in manual mode": Fault("operational mode", "remote", {**POLYSCOPE_X, "operational_mode": "MANUAL"}),
    "another arm on PolyScope X": Fault("arm serial", "serial", {**POLYSCOPE_X, "serial": "20235500009"}),
    "a folder that is a file": Fault("free disk", "disk", asked={"folder": Path(__file__) / "recordings"}),
    "little memory for USB": Fault("USB memory", "usb", checked={"facts": {"transport": "BaslerUsb"}, "usb_mb": 16.0}),
    "a camera that runs hot by its own word": Fault(
        "camera temperature", "heat", camera={"BslTemperatureStatus": Setting("Critical")}
    ),
    "a camera without a way to choose what it loads": Fault("factory settings", "default", without=("UserSetSelector",)),
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
    together: dict[str, Any] = {key: {} for key in ("install", "safety", "camera", "asked", "stated_camera", "robot", "checked")}
    for fault in faults:
        for key, values in together.items():
            values.update(getattr(fault, key))
    nodes, serial = emulation
    stated = {"serial": serial, "firmware": nodes.read("DeviceFirmwareVersion"), **together["stated_camera"]}
    robot = {"client": "ur_rtde", "installation": STATED, **together["robot"]}
    description = RigDescription.model_validate({"robot": robot, "camera": stated})
    try:
        controller.ask("install", **together["install"])
        controller.ask("safety", **together["safety"])
        controller.ask("speed_slider", fraction=min([1.0, *(fault.slider for fault in faults)]))
        controller.ask("noise", noise_rad=max([4e-6, *(fault.noise_rad for fault in faults)]))
        controller.ask("silent", seconds=60.0 * any(fault.silent for fault in faults))
        own = {"needed": 1e6, "now": lambda: NOW, "folder": folder, **together["asked"]}
        seconds = 1.2 if "latency_s" in together["install"] else 0.25
        lines = examine_arm(controller.host, description, seconds=seconds, longest_gap_s=GAP_S, rate=None, **own)
        without = [name for fault in faults for name in fault.without]
        over = SimulatedNodes(nodes, "ace USB", without=without, changed=together["camera"])
        computer = {"facts": {"transport": "BaslerUsb"}, "usb_mb": 1000.0, **together["checked"]}
        return [*lines, *check(over, serial, stated=description.camera, genicam=True, **computer)]
    finally:
        for mend in ("install", "safety", "noise"):
            controller.ask(mend)
        controller.ask("silent", seconds=0.0)
        controller.ask("speed_slider", fraction=1.0)


def named(lines: list[Line]) -> list[str]:
    return [line.name for line in lines if line.verdict is Verdict.WRONG]


def test_there_are_enough_faults():
    assert len(FAULTS) >= 60 and len({fault.line for fault in FAULTS.values()}) >= 25


def test_a_rig_in_order_is_ok_in_every_line(controller, emulation, tmp_path):
    lines = examine(controller, emulation, [], tmp_path)
    assert [line for line in lines if line.verdict is not Verdict.OK] == []
    refuse_wrong(lines, "here")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=API if POLYSCOPE_X.items() <= fault.install.items() else ()) for name, fault in FAULTS.items()],
)
def test_a_fault_is_named_and_nothing_else(controller, emulation, tmp_path, name):
    lines = examine(controller, emulation, [FAULTS[name]], tmp_path)
    assert named(lines) == [FAULTS[name].line]
    (line,) = [line for line in lines if line.verdict is Verdict.WRONG]
    assert line.found and line.remedy
    assert {line.name for line in lines if line.verdict is Verdict.UNKNOWN} == set(FAULTS[name].hides)
    if line.blocks:
        with pytest.raises(NotReady, match="the rig is not ready"):
            refuse_wrong(lines, controller.host)


@pytest.mark.parametrize("seed", range(4))
def test_several_faults_are_all_named(controller, emulation, tmp_path, seed):
    rng = np.random.default_rng(seed)
    alone = [name for name, fault in FAULTS.items() if not (fault.silent or fault.robot or "dashboard" in fault.install)]
    by_part = {FAULTS[name].part: FAULTS[name] for name in rng.permutation(alone) if "primary" not in FAULTS[name].install}
    chosen = [by_part[part] for part in rng.permutation(sorted(by_part))[:6]]
    assert sorted(named(examine(controller, emulation, chosen, tmp_path))) == sorted(fault.line for fault in chosen)


def test_polyscope_x_has_no_dashboard_and_needs_none(controller, emulation, tmp_path):
    """Without one nobody says who has control; all else is still found out."""
    polyscope_x = Fault("dashboard", "dashboard", {"dashboard": False, "version": [10, 7, 0, 0]}, robot={"client": "auto"})
    lines = {line.name: line for line in examine(controller, emulation, [polyscope_x], tmp_path)}
    assert named(list(lines.values())) == [] and "PolyScope X" in lines["dashboard"].found
    assert lines["remote control"].verdict is Verdict.UNKNOWN
    assert lines["software"].found == "10.7.0" and lines["program"].verdict is Verdict.OK


@API
def test_the_robot_api_says_what_a_dashboard_would(controller, emulation, tmp_path):
    lines = {line.name: line for line in examine(controller, emulation, [Fault("", "", POLYSCOPE_X)], tmp_path)}
    assert {line.name for line in lines.values() if line.verdict is not Verdict.OK} == set()
    assert "Robot API answers (version 5.0.107)" in lines["dashboard"].found
    assert lines["operational mode"].found == "automatic mode" and lines["remote control"].found == "in remote control"
    closed = Fault("", "", {**POLYSCOPE_X, "robot_api": False})
    lines = {line.name: line for line in examine(controller, emulation, [closed], tmp_path)}
    assert lines["dashboard"].verdict is Verdict.UNKNOWN and "does not answer" in lines["dashboard"].found


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_is_brought_to_srgb_by_its_own_name_and_the_doctor_puts_it_back(emulation, family):
    nodes, serial = emulation
    over = SimulatedNodes(nodes, family)
    names = {"ace USB": "ColorSpace", "ace 2": "BslColorSpace", "dart": "BslColorSpaceMode", "ace GigE": "GammaSelector"}
    before = over.read(names[family])
    assert named(check(over, serial, {}, RigDescription().camera, genicam=True)) == []
    assert over.read(names[family]) == before and before.lower() != "srgb"
    assert set_colour_space(over, encoded=True) == names[family]
    assert over.read(names[family]).lower() == "srgb"
    assert family != "ace GigE" or over.read("GammaEnable") is True


def test_the_doctor_changes_nothing_on_a_camera(emulation):
    """On the emulation itself: every setting that it saves, with values that no session leaves."""
    nodes, serial = emulation
    nodes.write("ReverseX", True)
    nodes.write("BlackLevel", 3.0)
    try:
        before = saved(nodes)
        assert "ReverseX\t1" in before
        assert named(check(SimulatedNodes(nodes, "ace USB"), serial, {}, RigDescription().camera, genicam=True)) == []
        assert saved(nodes) == before
    finally:
        nodes.write("ReverseX", False)
        nodes.write("BlackLevel", 0.0)


def saved(nodes: Any) -> str:
    from pypylon import pylon

    return pylon.FeaturePersistence.SaveToString(nodes._camera.GetNodeMap())


def test_what_a_camera_has_is_what_can_be_read_or_written(emulation):
    """The emulation's trigger command can only be written."""
    from pypylon import genicam

    nodes, _ = emulation
    command = nodes._camera.GetNodeMap().GetNode("TriggerSoftware")
    nodes.write("TriggerMode", "On")
    nodes.write("TriggerSource", "Software")
    assert not genicam.IsReadable(command) and genicam.IsWritable(command) and nodes.has("TriggerSoftware")
    nodes.write("TriggerMode", "Off")
