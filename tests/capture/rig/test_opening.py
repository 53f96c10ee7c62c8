"""Which rig and scene are opened, and that a rig is opened completely or not at all."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from koala3d.capture.drivers.errors import RigConnectionError
from koala3d.capture.model.rig import RigDescription, load_rig, recorded_rig
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.rig import arms, opening
from koala3d.capture.rig.arms import open_arm
from koala3d.capture.rig.controllers import write_simulated_rig
from koala3d.capture.rig.naming import describe, scene_for
from koala3d.capture.rig.opening import open_rig
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.capture.sim.grbl import SimulatedGrbl
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import Recording

SMALL = ["camera.width=48", "camera.height=48", "camera.binning=4"]


@pytest.fixture
def koala() -> Trajectory:
    return load_trajectory("koala_demo", overrides=SMALL)


@pytest.fixture
def running_rig(tmp_path: Path) -> Path:
    """The file of a simulated rig that runs elsewhere, as `capture sim` writes it."""
    path = tmp_path / "rig.yaml"
    handle: Any = SimpleNamespace(host="127.0.0.9", side_port=4321)
    write_simulated_rig(path, handle, "shiny_ball", 5)
    return path


def test_a_rig_is_found_by_name_or_path(running_rig: Path) -> None:
    assert describe("sim") == RigDescription() == describe("ur5e_basler")
    assert describe(str(running_rig)).robot.host == "127.0.0.9"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "ur5e_baslr",
            [
                "there is no rig 'ur5e_baslr'",
                "known: sim, franka_basler, franka_realsense, sim_flawed, ur10e_gige, ur5e_basler",
                "did you mean 'ur5e_basler'?",
            ],
        ),
        ("simm", ["did you mean 'sim'?"]),
        ("nowhere.yaml", ["nowhere.yaml: no such file", "'capture list'"]),
        ("rigs/mine", ["rigs/mine: no such file"]),
    ],
)
def test_a_missing_rig_is_one_clear_message(name: str, words: list[str]) -> None:
    with pytest.raises(UsageError) as caught:
        describe(name)
    assert [part for part in words if part not in str(caught.value)] == []


def test_the_file_of_a_running_simulation_reads_back_and_is_not_overwritten(running_rig: Path) -> None:
    simulation = load_rig(running_rig).simulation
    assert simulation is not None and (simulation.side_port, simulation.scene, simulation.seed) == (4321, "shiny_ball", 5)
    handle: Any = SimpleNamespace(host="127.0.0.1", side_port=1)
    with pytest.raises(UsageError, match="already exists"):
        write_simulated_rig(running_rig, handle, "gold_head", 0)


def test_the_scene_fits_the_trajectory(koala: Trajectory, running_rig: Path) -> None:
    board = load_trajectory("calibration_demo")
    assert (scene_for("sim", "", koala), scene_for("sim", "", board)) == ("gold_head", "board")
    assert scene_for("sim", "crystal_capture", koala) == "crystal_capture"
    assert scene_for(str(running_rig), "", koala) == "shiny_ball"  # what the running simulation shows
    assert scene_for("ur5e_basler", "", koala) == ""
    with pytest.raises(UsageError, match="--scene is only for simulated rigs"):
        scene_for("ur5e_basler", "gold_head", koala)
    with pytest.raises(UsageError, match="needs a trajectory with 'target'"):
        scene_for("sim", "board", koala)
    with pytest.raises(UsageError, match="needs a trajectory with 'object'"):
        scene_for("sim", "gold_head", board)


def test_the_rig_of_a_recording_is_in_its_manifest() -> None:
    described = RigDescription.model_validate({"robot": {"host": "10.0.0.7"}})
    rig = {"name": "mine.yaml", **described.model_dump(mode="json")}
    assert recorded_rig(Recording(Path("rec"), {"rig": rig})) == described
    assert recorded_rig(Recording(Path("rec"), {})) == RigDescription()
    with pytest.raises(UsageError, match=r"rec/manifest.json, rig: unknown key 'colour'"):
        recorded_rig(Recording(Path("rec"), {"rig": {"colour": 1}}))


def test_the_simulated_rig_has_the_truth_and_its_seed(koala: Trajectory) -> None:
    with open_rig("sim", koala, scene="shiny_ball", seed=3, time_scale=50) as rig:
        assert rig.ground_truth is rig.camera and rig.name == "sim"
        assert rig.extra == {"scene": "shiny_ball", "seed": 3, "pose": "upright"}
        assert rig.camera.description()["simulated"] and rig.robot.description()["model"]
        np.testing.assert_array_equal(rig.flange_from_camera, RigDescription().flange_from_camera.matrix())


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is opened and closed, in order; the controller is a stand-in."""
    events: list[str] = []

    @contextmanager
    def controller(**arguments: Any) -> Iterator[Any]:
        events.append(f"controller {arguments['links_seed']} hangs={arguments['hangs']}")
        try:
            yield SimpleNamespace(host="127.0.0.1")
        finally:
            events.append("controller closed")

    @contextmanager
    def arm(*arguments: Any) -> Iterator[Any]:
        events.append("arm")
        try:
            yield "arm"
        finally:
            events.append("arm closed")

    monkeypatch.setattr(SimulatedController, "as_built", controller)
    monkeypatch.setattr(opening, "arm_of", arm)
    monkeypatch.setattr(arms, "arm_of", arm)
    return events


def test_a_second_camera_that_cannot_be_opened_is_named_and_the_first_one_closed(
    koala: Trajectory, watched: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def enter(camera: Any) -> Any:
        if len([event for event in watched if event == "camera"]) == 1:
            raise RigConnectionError("no camera was found", where="camera 7", remedy="check its cable")
        watched.append("camera")
        return camera

    monkeypatch.setattr("koala3d.capture.sim.camera.SimulatedCamera.__enter__", enter)
    monkeypatch.setattr(
        "koala3d.capture.sim.camera.SimulatedCamera.__exit__", lambda camera, *error: watched.append("camera closed")
    )
    with pytest.raises(RigConnectionError, match=r"^camera 'right', camera 7: no camera was found; check its cable$"):
        with open_rig("sim:ur5e_stereo", koala, scene="shiny_ball", seed=0, time_scale=20):
            raise AssertionError("not reached")
    assert watched == ["controller None hangs=False", "camera", "camera closed", "controller closed"]


def test_each_of_two_simulated_cameras_has_its_own_lens_and_mount(koala: Trajectory, watched: list[str]) -> None:
    with open_rig("sim:ur5e_stereo", koala, scene="shiny_ball", seed=3, time_scale=50) as rig:
        left, right = rig.each["left"].camera, rig.each["right"].camera
        assert rig.camera is left and list(rig.each) == ["left", "right"]
        serials = [camera.description()["serial"] for camera in (left, right)]
        truth = [camera.truth for camera in (left, right)]  # type: ignore[attr-defined]
    assert len(set(serials)) == 2 and truth[0].sensor_camera != truth[1].sensor_camera
    between = np.linalg.inv(truth[0].flange_from_camera) @ truth[1].flange_from_camera
    off = np.linalg.norm(between[:3, 3] - [0.06, 0.0, 0.0])
    assert 1e-4 < off < 2 * 3e-3 + 0.06 * np.deg2rad(2)  # two brackets, each 3 mm and 1 degree off its drawing


def test_one_measured_response_is_not_for_two_cameras(koala: Trajectory) -> None:
    with pytest.raises(UsageError, match=r"flat.npz: one response for several cameras; leave --radiometry out"):
        with open_rig("sim:ur5e_stereo", koala, scene="", seed=0, time_scale=20, radiometry=Path("flat.npz")):
            raise AssertionError("not reached")


def test_the_file_of_a_running_pair_reads_back(tmp_path: Path) -> None:
    handle: Any = SimpleNamespace(host="127.0.0.9", side_port=4321)
    write_simulated_rig(tmp_path / "pair.yaml", handle, "board", 5, describe("ur5e_stereo"))
    assert load_rig(tmp_path / "pair.yaml").cameras == describe("ur5e_stereo").cameras


def test_the_arm_alone_needs_no_camera(koala: Trajectory, watched: list[str]) -> None:
    with open_arm("sim", koala, seed=1, links_seed=4, time_scale=20) as (robot, controller):
        assert robot == "arm" and controller is not None
    assert watched == ["controller 4 hangs=False", "arm", "arm closed", "controller closed"]


def test_a_hanging_trajectory_starts_a_hanging_arm(watched: list[str]) -> None:
    with open_arm("sim", load_trajectory("koala_hanging"), seed=0, links_seed=0, time_scale=20):
        pass
    assert watched[0] == "controller 0 hangs=True"


def test_a_camera_that_cannot_be_opened_leaves_no_controller(
    koala: Trajectory, watched: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(camera: Any) -> None:
        raise RigConnectionError("no camera")

    monkeypatch.setattr("koala3d.capture.sim.camera.SimulatedCamera.__enter__", fail)
    with pytest.raises(RigConnectionError, match="no camera"):
        with open_rig("sim", koala, scene="shiny_ball", seed=0, time_scale=20):
            raise AssertionError("not reached")
    assert watched == ["controller None hangs=False", "controller closed"]


@pytest.mark.parametrize("missing", ["camera", "arm", "nothing"])
def test_the_table_of_a_real_rig_looks_for_its_switch_once_camera_and_arm_are_connected(
    missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def device(kind: str) -> Iterator[str]:
        if kind == missing:
            raise RigConnectionError(f"no {kind} was found")
        yield kind

    monkeypatch.setattr(opening, "camera_in", lambda *arguments: (device("camera"), None))
    monkeypatch.setattr(opening, "arm_of", lambda *arguments: device("arm"))
    with SimulatedGrbl(time_scale=50, state="Alarm") as controller:
        rig = describe("ur5e_turntable").model_dump(mode="json", include={"turntable"})
        rig["robot"] = {"installation": {"payload_kg": 0.5}}
        rig["turntable"] |= {"address": controller.address, "homing": True}
        (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
        with ExitStack() as stack:
            if missing != "nothing":
                stack.enter_context(pytest.raises(RigConnectionError, match=f"^no {missing} was found$"))
            trajectory = load_trajectory("koala_turntable")
            opened = stack.enter_context(open_rig(str(tmp_path / "rig.yaml"), trajectory, scene="", seed=0, time_scale=1))
            assert (opened.camera, opened.robot) == ("camera", "arm") and opened.turntable is not None
        assert controller.state == ("Idle" if missing == "nothing" else "Alarm")  # the way to the switch ends the alarm


def test_a_rig_without_the_table_that_the_views_turn_is_not_opened(watched: list[str]) -> None:
    with pytest.raises(UsageError, match="the rig has no turntable"):
        with open_rig("sim", load_trajectory("koala_turntable"), scene="shiny_ball", seed=0, time_scale=20):
            raise AssertionError("not reached")
    assert watched == []
