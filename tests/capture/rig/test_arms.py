"""Rigs with other arms: described, planned, simulated, recorded, and built into scenes."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.cli import main
from koala3d.capture.model.rig import load_rig, recorded_carrier
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.planning import plan
from koala3d.capture.recording.replay import obstacles_around, replay, summary
from koala3d.capture.rig.arms import open_arm
from koala3d.capture.rig.controllers import controller_model
from koala3d.capture.rig.naming import describe
from koala3d.datasets import pose
from koala3d.datasets.building.build import build
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import load_scene
from koala3d.datasets.recording import Recording

SMALL = ["camera.width=48", "camera.height=36", "camera.binning=1", "views.0.count=3", "split.train=2", "split.test=1"]
SMALL += ["views.0.rings=1", "views.0.elevation_deg=[45, 45]"]
RIGS = {"ur10e_gige": ("koala_ur10e", "UR10e", 6), "franka_basler": ("koala_franka", "Franka Panda", 7)}


def session(name: str) -> Trajectory:
    return load_trajectory(name, overrides=SMALL)


@pytest.mark.parametrize("name", RIGS)
def test_a_shipped_rig_is_planned_with_its_own_arm(name: str) -> None:
    trajectory, arm, count = RIGS[name]
    carrier = describe(name).carrier()
    planned = plan(session(trajectory), carrier)
    assert carrier.arm.name == arm and len(planned) == 3
    for view in planned:
        assert view.joints.shape == (count,) and carrier.permitted(view.joints)
        wanted = view.viewpoint.base_from_camera
        np.testing.assert_allclose(carrier.arm.forward(view.joints) @ carrier.flange_from_camera, wanted, atol=1e-6)


@pytest.mark.parametrize("name", RIGS)
def test_a_shipped_rig_is_simulated_recorded_replayed_and_built(run_inside, name: str, tmp_path: Path) -> None:
    trajectory, arm, count = RIGS[name]
    chosen = session(trajectory)
    words = ["--rig", f"sim:{name}", "--scene", "shiny_ball", "--seed", 2, "--time-scale", 50, "--out", tmp_path / "rec"]
    changes = [word for change in SMALL for word in ("--set", change)]
    done = run_inside(main, "capture", "run", trajectory, *words, *changes)
    assert done.returncode == 0, done.stderr
    recording = Recording.open(tmp_path / "rec")
    assert recording.manifest["robot"]["model"] == arm
    assert [frame.joints.shape for frame in recording.frames] == [(count,)] * 3 and recording.links.count == count
    carrier = recorded_carrier(recording)
    assert carrier.arm.name == arm and recording.manifest["arm"]["name"] == arm
    for frame in recording.frames:
        off, turn = pose.difference(carrier.arm.forward(frame.joints), frame.base_from_flange)
        assert 1e-5 < off < 0.01 and turn < 0.02, "as built, within millimetres of the nominal arm"

    with open_arm(f"sim:{name}", chosen, seed=3, links_seed=2, time_scale=50.0) as (robot, _):
        found = summary(replay(recording, robot, obstacles_around(recording, describe(f"sim:{name}"))))
    assert found["joints_deg"]["worst"] < 0.02 and found["translation_mm"]["worst"] < 0.5

    truth = files.read_json(tmp_path / "rec" / "truth" / "poses.json")
    camera = Camera.from_json(truth["camera"], where="truth")
    known = UncertainPose(np.array(truth["flange_from_camera"]), 1e-8 * np.eye(6))
    Calibration(camera, {}, known, known).save(tmp_path / "cal.json")
    build(tmp_path / "rec", tmp_path / "cal.json", tmp_path / "koala" / "ball")
    scene = load_scene("koala/ball", data_root=tmp_path)
    assert len(scene.views) == 3
    for view in scene.views:
        off, _ = pose.difference(view.world_from_camera, np.array(truth["base_from_camera"][view.name]))
        assert off < 1e-3, "where the camera truly was, within the repeatability of the arm"


def test_an_arm_without_a_driver_is_only_simulated() -> None:
    with pytest.raises(UsageError, match=r"Koala has no driver for the Franka Panda.*'--rig sim:NAME' simulates it"):
        with open_arm("franka_basler", session("koala_franka"), seed=0, links_seed=0, time_scale=1.0):
            pass
    with pytest.raises(UsageError, match="the Franka Panda has no simulated controller"):
        controller_model(describe("franka_basler"))


def written(tmp_path: Path, text: str) -> Path:
    (tmp_path / "rig.yaml").write_text(text)
    return tmp_path / "rig.yaml"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot: {model: ur11}", "there is no arm 'ur11'.*ur10e"),
        (
            "robot: {cable: {max_turns: 1, joints: [7]}}",
            r"rig.yaml: robot.cable.joints names a joint.*the UR5e has joints 1 to 6",
        ),
        ("robot: {cable: {max_turns: 1, joints: [5, 6], rest_deg: [0]}}", "needs an angle for each joint.*1 angles for 2"),
        ("robot: {cable: {max_turns: 0}}", "greater than 0"),
        ("obstacles: [{kind: cone, name: c}]", "kind"),
        ("obstacles: [{kind: box, name: c, size: [1, 1, 1]}, {kind: cylinder, name: c, radius: 1, height: 1}]", "the same name"),
        ("camera: {body: [{name: lens, start: [0, 0, 0], end: [0, 0, 1], radius: -1}]}", "radius"),
    ],
)
def test_what_does_not_fit_is_one_clear_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        load_rig(written(tmp_path, text))


def test_files_beside_a_rig_file_are_found(tmp_path: Path) -> None:
    import trimesh

    from koala3d import configs

    shipped = Path(configs.__file__).parent / "arms" / "ur3e.yaml"
    (tmp_path / "mine.yaml").write_text(shipped.read_text().replace("name: UR3e", "name: Mine"))
    trimesh.creation.box((0.2, 0.2, 0.2)).export(tmp_path / "shelf.ply")
    path = written(tmp_path, "robot: {model: mine.yaml}\nobstacles: [{kind: mesh, name: shelf, file: shelf.ply}]\n")
    carrier = load_rig(path).carrier()
    assert carrier.arm.name == "Mine" and carrier.solids[0].distance(np.zeros((1, 2, 3)))[0] == pytest.approx(0.1, abs=0.006)
