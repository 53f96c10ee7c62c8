"""The arm goes to views by name, and the object's box lies where the camera sees the object."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.rig.opening import open_rig
from koala3d.capture.rig.rig import Rig
from koala3d.capture.sessions.live.jog import Jog
from koala3d.capture.sessions.live.outline import COLOUR, Outline
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging.region import Region

SMALL = ("camera.width=96", "camera.height=96", "camera.binning=4")
CAMERA = Camera(96, 96, 120.0, 120.0, 48.0, 48.0, k1=-0.1)


@pytest.fixture(scope="module")
def session() -> Trajectory:
    return load_trajectory("koala_demo", overrides=[*SMALL])


@pytest.fixture(scope="module")
def rig(session: Trajectory) -> Iterator[Rig]:
    with open_rig("sim", session, scene="shiny_ball", seed=0, time_scale=200.0) as opened:
        yield opened


def calibrated(camera: Camera = CAMERA, region: Region | None = None) -> Calibration:
    mount = UncertainPose(pose.rigid(np.eye(3), [0.0, -0.06, 0.05]), np.zeros((6, 6)))
    return Calibration(camera, {}, mount, region=region)


def test_the_arm_goes_to_a_view_by_name_and_again_only_after_a_stop_is_cleared(rig: Rig, session: Trajectory) -> None:
    jog = Jog(rig.robot, session, rig.carrier)
    names = list(jog.views)
    jog.go(names[3])
    reached = rig.carrier.base_from_camera(rig.robot.state().joints)
    wanted = jog.views[names[3]].camera_pose(rig.carrier)
    np.testing.assert_allclose(reached[:3, 3], wanted[:3, 3], atol=2e-4)
    np.testing.assert_allclose(reached[:3, 2], wanted[:3, 2], atol=1e-3)  # it may be rolled
    rig.robot.stop()
    with pytest.raises(CaptureError, match="stopped"):
        jog.go(names[4])
    rig.robot.clear_stop()
    with pytest.raises(UsageError, match="there is no view"):
        jog.go("nowhere")


def test_edges_meet_at_the_corners_of_the_box(session: Trajectory) -> None:
    outline = Outline.of(session, calibrated(), {})
    low, high = outline.corners
    place = pose.look_at((low + high) / 2 + [0.4, 0.1, 0.3], (low + high) / 2)
    edges = outline.edges(place)
    corners = np.stack(np.meshgrid(*np.stack([low, high], -1), indexing="ij"), -1).reshape(-1, 3)
    expected = CAMERA.project((corners - place[:3, 3]) @ place[:3, :3])
    ends = np.concatenate([edge[[0, -1]] for edge in edges])
    assert len(edges) == 12
    assert max(np.linalg.norm(expected - end, axis=1).min() for end in ends) < 1e-6
    assert sum(np.linalg.norm(ends - corner, axis=1).min() < 1e-6 for corner in expected) == 8
    np.testing.assert_allclose(outline.middle(place), CAMERA.project(np.array([0.0, 0.0, 1.0])), atol=1e-9)


def test_what_is_behind_the_camera_is_not_drawn(session: Trajectory) -> None:
    outline = Outline.of(session, calibrated(), {})
    inside = pose.rigid(np.eye(3), outline.corners.mean(0))  # looks along z from the middle of the box
    assert len(outline.edges(inside)) == 8 and outline.middle(inside) is None
    assert all(np.isfinite(edge).all() for edge in outline.edges(inside))


def test_box_and_cross_are_drawn_in_a_smaller_picture(session: Trajectory) -> None:
    outline = Outline.of(session, calibrated(), {})
    middle = outline.corners.mean(0)
    flange = pose.look_at(np.add(middle, [0.3, 0, 0.3]), middle) @ pose.inverse(outline.calibration.flange_from_camera.matrix)
    drawn = outline.drawn(np.zeros((48, 48, 3), np.uint8), flange, np.zeros(6))
    assert (drawn[23:25, 23:25, 0] > 100).all()  # the cross lies between these pixels
    assert 50 < drawn.any(-1).sum() < 800


def test_intrinsics_follow_the_region_of_the_sensor(session: Trajectory) -> None:
    whole = Camera(192, 192, 240.0, 240.0, 96.0, 96.0)
    outline = Outline.of(session, calibrated(whole, Region(192, 192)), {"region": Region(96, 96, binning=2).to_json()})
    assert (outline.camera.width, outline.camera.fx, outline.camera.cx) == (96, 120.0, 48.0)
    with pytest.raises(UsageError, match="another image size"):
        Outline.of(session, calibrated(whole), {})
    with pytest.raises(DatasetError, match="no hand-eye pose"):
        Outline.of(session, Calibration(CAMERA, {}), {})


def test_the_command_moves_the_arm_and_draws_the_box(tmp_path: Path, session: Trajectory, run_inside) -> None:
    from koala3d.capture.cli import main

    Calibration.save(calibrated(), tmp_path / "calibration.json")
    words = [word for change in SMALL for word in ("--set", change)]
    words += ["--once", "--scene", "shiny_ball", "--calibration", tmp_path / "calibration.json"]
    refused = run_inside(main, "capture", "look", "koala_demo", *words)
    assert refused.returncode == 2 and "add --arm" in refused.stderr
    name = session.viewpoints()[5].name
    done = run_inside(main, "capture", "look", "koala_demo", *words, "--go", name, "--picture", tmp_path / "look.png")
    assert done.returncode == 0, done.stderr
    from koala3d.datasets.imaging import images

    picture = images.read(tmp_path / "look.png")[..., :3]
    drawn = np.abs(255 * picture - np.array(COLOUR)).max(-1) < 30
    assert drawn.sum() > 60
