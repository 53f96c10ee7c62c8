"""Views under several sets of lamps: what burns, what the pictures show, what is written, and what is left burning."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.cli import main
from koala3d.capture.drivers.errors import RigConnectionError
from koala3d.capture.drivers.ur.outputs import DigitalOutputs
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning import plan
from koala3d.capture.recording import session_log
from koala3d.capture.recording.check import check
from koala3d.capture.recording.recorder import record
from koala3d.capture.rig.controllers import write_simulated_rig
from koala3d.capture.rig.naming import describe
from koala3d.capture.rig.opening import open_rig
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Recording
from tests.moments import until

RIG = "lamps: {left: {output: 3}, right: {output: 5}}\nlights: [{name: ring, stands: flange}, {name: right, stands: room}]\n"
SETS = "[[left], [right], [left, right], []]"
VIEWS = (
    "views=[{kind: orbit, target: [0.4, 0, 0.14], distance: 0.4, elevation_deg: 50, count: 2, roll_deg: [0, 90, 180, 270], "
    f"lamps: {SETS}}}]"
)
SMALL = ["camera.binning=4", "camera.width=48", "camera.height=32", "split=null", VIEWS]
LEFT, RIGHT = 1 << 3, 1 << 5


@pytest.fixture
def trajectory():
    return load_trajectory("koala_demo", overrides=SMALL)


@pytest.fixture
def controller():
    with SimulatedController.start(seed=5, time_scale=20.0) as found:
        yield found


@pytest.fixture
def rig(tmp_path, controller) -> str:
    """A rig file of the running controller."""
    (tmp_path / "lamps.yaml").write_text(RIG)
    write_simulated_rig(tmp_path / "rig.yaml", controller, "gold_head", 5, describe(str(tmp_path / "lamps.yaml")))
    return str(tmp_path / "rig.yaml")


def bits(controller) -> int:
    return controller.signals()["digital"]


def test_outputs_are_switched_together_and_the_others_left_alone(controller):
    with DigitalOutputs(controller.host) as outputs:
        outputs.set_outputs({1, 7}, set())
        assert bits(controller) == 1 << 1 | 1 << 7
        outputs.set_outputs({3}, {7})
        assert bits(controller) == 1 << 1 | 1 << 3
        with pytest.raises(RigConnectionError, match="outputs are in use"), DigitalOutputs(controller.host):
            pass
    with DigitalOutputs(controller.host) as outputs:
        controller.ask("drop")
        until(lambda: not outputs._stream.connected or outputs._stream.newest(0.1) is None, "the lost connection")
        with pytest.raises(RigConnectionError, match="were not switched"):
            outputs.set_outputs({2}, set())


def test_each_view_is_taken_under_each_set_while_the_arm_stands_still(trajectory):
    views = trajectory.viewpoints()
    assert [view.lamps for view in views[:4]] == [("left",), ("right",), ("left", "right"), ()]
    assert trajectory.number == len(views) == 8 and [view.name for view in views] == [f"00{i}" for i in range(8)]
    planned = plan(trajectory, RigDescription().carrier())
    for first in (0, 4):
        assert all(np.array_equal(view.joints, planned[first].joints) for view in planned[first : first + 4])
    assert load_trajectory("koala_demo").viewpoints()[0].lamps is None and not load_trajectory("koala_demo").switches


def test_a_split_counts_a_view_once_and_keeps_its_pictures_together():
    split = load_trajectory(
        "koala_demo", overrides=[*SMALL[:3], "split={train: 4, test: 2}", VIEWS.replace("count: 2", "count: 6")]
    )
    uses = np.array(split.splits).reshape(6, 4)
    assert (uses == uses[:, :1]).all() and (uses[:, 0] == "test").sum() == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("views.0.lamps=[[left, left]]", "listed twice"),
        ("views.0.lamps=[[left, right], [right, left]]", "same lamps"),
        ("views.0.lamps=[]", "at least 1"),
        ("views.0.lamps=[['over there']]", "pattern"),
    ],
)
def test_impossible_sets_are_refused(change, message):
    with pytest.raises(UsageError, match=message):
        load_trajectory("koala_demo", overrides=[*SMALL, change])


def test_the_right_lamps_burn_for_each_picture_and_none_afterwards(trajectory, controller, rig, tmp_path):
    seen, out = [], tmp_path / "rec"
    with open_rig(rig, trajectory, scene="gold_head", seed=0, time_scale=1.0) as opened, session_log.kept(out):
        grab = opened.camera.grab
        opened.camera.grab = lambda: seen.append(bits(controller)) or grab()
        record(trajectory, opened, out)
    assert seen == [LEFT, RIGHT, LEFT | RIGHT, 0] * 2 and bits(controller) == 0
    frames = Recording.open(out).frames
    assert [frame.lights for frame in frames] == [("ring", *names) for names in (["left"], ["right"], ["left", "right"], [])] * 2
    still = [frame.joints for frame in frames[:4]]
    np.testing.assert_allclose(still, [still[0]] * 4, atol=1e-9)
    switched = [one.facts["on"] for one in session_log.read(out) if one.name == "lamps"]
    assert switched == [["left"], ["right"], ["left", "right"], []] * 2

    left, right, both, dark = (
        images.linear_from_srgb(images.read(Recording.open(out).image_path(frame))) for frame in frames[:4]
    )
    # light adds up, apart from noise (2 % of white) and what is clipped
    free = (both < 0.9).all(-1)
    assert free.mean() > 0.7 and abs(np.mean((left + right - dark - both)[free])) < 0.01
    assert dark.mean() < 0.5 * left.mean() and np.abs(left - right)[free].mean() > 0.1 * left.mean()
    assert not [one for one in check(out) if one.what == "is blurred"]


def test_lamps_go_out_after_a_fault(trajectory, controller, rig, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        with open_rig(rig, trajectory, scene="grey_card", seed=0, time_scale=1.0) as opened:
            opened.lamps.switch(["left"])
            assert bits(controller) == LEFT
            controller.ask("stop_program")  # the arm's program has ended, too
            raise KeyboardInterrupt
    assert bits(controller) == 0


def test_lamps_that_the_rig_lacks_are_refused_before_anything_moves(trajectory, tmp_path):
    (tmp_path / "one.yaml").write_text("lamps: {left: {output: 3}}\n")
    (tmp_path / "same.yaml").write_text("lamps: {left: {output: 3}, right: {output: 3}}\n")
    for name, message in (("one", "no lamp called 'right' can be switched"), ("same", "two lamps have the same output")):
        with pytest.raises(UsageError, match=message):
            with open_rig(f"sim:{tmp_path / name}.yaml", trajectory, scene="grey_card", seed=0, time_scale=20.0):
                pass


def test_a_scene_is_built_for_each_set(controller, rig, tmp_path, run_inside):
    from koala3d.datasets.calibration import Calibration, UncertainPose
    from koala3d.datasets.cli import main as datasets_main
    from koala3d.datasets.formats import koala

    (tmp_path / "t.yaml").write_text(
        "format: koala-trajectory\nversion: 1\nname: lit\nsplit: {train: 1, test: 1}\n"
        "object: {centre: [0.4, 0, 0.1], size: [0.2, 0.2, 0.2]}\n"
        "camera: {binning: 4, width: 48, height: 32}\nviews:\n  - kind: orbit\n    target: [0.4, 0, 0.14]\n    distance: 0.4\n"
        f"    elevation_deg: 50\n    count: 2\n    roll_deg: [0, 90, 180, 270]\n    lamps: {SETS}\n"
    )
    out = tmp_path / "rec"
    done = run_inside(main, "capture", "run", tmp_path / "t.yaml", "--rig", rig, "--scene", "grey_card", "--out", out)
    assert done.returncode == 0, done.stderr
    truth = files.read_json(out / "truth" / "poses.json")
    from koala3d.datasets.camera_model import Camera

    mount = UncertainPose(np.array(truth["flange_from_camera"]), np.eye(6) * 1e-12)
    Calibration(Camera.from_json(truth["camera"], where="truth"), {}, mount).save(tmp_path / "calibration.json")
    words = ["datasets", "build", out, "--calibration", tmp_path / "calibration.json", "--out", tmp_path / "scenes"]
    built = run_inside(datasets_main, *words)
    assert built.returncode == 0, built.stderr
    names = sorted(path.name for path in Path(tmp_path / "scenes").iterdir())
    assert names == ["ring", "ring+left", "ring+left+right", "ring+right"]
    scenes = {name: koala.load(tmp_path / "scenes" / name) for name in names}
    assert all(sorted(view.split for view in scene.views) == ["test", "train"] for scene in scenes.values())
    light = {name: np.mean([view.read()[..., :3].mean() for view in scene.views]) for name, scene in scenes.items()}
    # the second lamp of the simulation is twice as bright as the first on evenly lit things
    assert light["ring"] < light["ring+left"] < light["ring+right"] < light["ring+left+right"]
    assert not any("incomplete" in note for scene in scenes.values() for note in scene.notes)
