"""Recordings of the rig with flaws, through pylon's emulation and real files."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.recording.check import check
from koala3d.capture.recording.recorder import record
from koala3d.capture.rig.cameras import camera_for
from koala3d.capture.rig.opening import open_rig
from koala3d.capture.sessions.live.flat import measured, statistics
from koala3d.datasets import pose
from koala3d.datasets.building.build import build
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.recording import Recording

SMALL = ("camera.binning=4", "camera.width=96", "camera.height=64", "motion.settle_time_s=0.02")
TWO = "views=[{kind: orbit, target: [0.4, 0, 0.14], distance: 0.4, count: 2, roll_deg: [0, 90, 180, 270]}]"


def session(pixel_format: str, *more: str) -> Trajectory:
    return load_trajectory("koala_demo", overrides=[*SMALL, "split=null", TWO, f"camera.pixel_format={pixel_format}", *more])


def nothing() -> None:
    """Progress that nobody watches."""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> tuple[Path, Path]:
    """A recording of the card with a bracket of 12 bits, and the flat field that it refers to."""
    folder = tmp_path_factory.mktemp("recorded")
    trajectory = session("bayer12", "camera.brackets=2", "camera.exposure_us=30000", "camera.bracket_factor=6")
    with camera_for(
        "sim_flawed",
        trajectory.model_copy(update={"camera": session("bayer12").camera}),
        scene="lens_cap",
        flat=folder / "flat.npz",
    ) as dark:
        black = statistics(dark, 8, nothing)
    with camera_for("sim_flawed", session("bayer12"), scene="grey_card", flat=folder / "flat.npz") as camera:
        measured(camera.description(), black, statistics(camera, 8, nothing)).save(folder / "flat.npz")
    options = {"scene": "grey_card", "seed": 0, "time_scale": 200.0, "radiometry": folder / "flat.npz"}
    with open_rig("sim_flawed", trajectory, **options) as rig:
        record(trajectory, rig, folder / "recording")
    return folder / "recording", folder / "flat.npz"


@pytest.fixture
def calibration(tmp_path: Path, recorded) -> Path:
    truth = files.read_json(recorded[0] / "truth" / "poses.json")
    known = UncertainPose(np.array(truth["flange_from_camera"]), 1e-8 * np.eye(6))
    from koala3d.datasets.camera_model import Camera

    camera = Camera.from_json(truth["camera"], where="truth")
    region = Region.from_json(Recording.open(recorded[0]).part("camera")["region"], where="truth")
    Calibration(camera, {"fx": 0.1}, known, known, region=region).save(tmp_path / "cal.json")
    return tmp_path / "cal.json"


def test_a_recording_holds_raw_values_and_the_flat_field(recorded):
    path, flat = recorded
    recording = Recording.open(path)
    assert (path / "radiometry.npz").read_bytes() == flat.read_bytes()
    assert recording.part("radiometry")["sha256"] == files.sha256(flat)
    for frame in recording.frames:
        assert [round(one.exposure_us) for one in frame.exposures] == [29_995, 5005]
        assert [one.file for one in frame.exposures] == [f"raw/{frame.name}.png", f"raw/{frame.name}_1.png"]
        raw = images.read_stored(path / frame.exposures[1].file)
        assert raw.shape == (64, 96, 1) and (raw & 15 == raw >> 12).all()  # 12 bits, repeated below
    assert files.read_json(path / "truth" / "poses.json")["flaws"]["black_level"] == 0.016
    assert not [finding for finding in check(path) if "exposure" in finding.what and "over" not in finding.what]


def test_darkness_stays_above_zero_while_noise_is_measured(recorded, tmp_path):
    """A camera without a black level cuts off half of the noise of darkness; `sim` is one."""
    trajectory = session("bayer12")
    with camera_for("sim", trajectory, scene="lens_cap", flat=tmp_path / "flat.npz") as camera:
        dark, sensor, sites = statistics(camera, 8, nothing), camera.sensor, trajectory.camera.binning**2
        assert camera.description()["black_level"] == 64 / 4095
    variance = (sensor.read_noise / sensor.full_well) ** 2 / sites + 1 / 12 / 4095**2  # of reading, and of whole numbers
    assert dark.variance.mean() == pytest.approx(variance, rel=0.05)
    assert dark.mean.min() > 0.01
    assert Recording.open(recorded[0]).part("camera")["black_level"] == 64 / 4095  # a session with a response keeps it
    with camera_for("sim", session("rgb8"), scene="lens_cap", flat=tmp_path / "flat.npz") as camera:
        assert camera.description()["black_level"] == 0  # it would be added to sRGB


def test_a_damaged_raw_picture_is_found(recorded, tmp_path):
    import shutil

    shutil.copytree(recorded[0], tmp_path / "copy")
    (tmp_path / "copy" / "raw" / "001_1.png").write_bytes(b"other")
    assert [(one.frame, one.what) for one in check(tmp_path / "copy") if one.again and "file of" in one.what] == [
        ("001", "a file of its exposures has changed")
    ]
    Recording.open(tmp_path / "copy").discard(["001"])
    assert [path.name for path in sorted((tmp_path / "copy" / "raw").iterdir())] == ["000.png", "000_1.png"]


def test_the_scene_shows_the_card_grey_and_unclipped(recorded, calibration, tmp_path):
    """The card is 1.8 times as bright as what saturates the longest exposure."""
    scene = build(recorded[0], calibration, tmp_path / "scene")
    assert any(
        "2 exposures are merged; 100.000 % of the pixels are clipped in the longest, 0.000 % in all" in note
        for note in scene.notes
    )
    for view in load_scene(tmp_path / "scene").views:
        light, deviation = view.read_image(), view.read_deviation()
        assert view.image.suffix == ".exr" and images.header(view.image).format == "half"
        np.testing.assert_allclose(light.mean(axis=(0, 1)), 1.8, rtol=0.01)
        assert float((light / light.mean()).std()) == pytest.approx(float((deviation / light).mean()), rel=0.5)
        assert view.white == pytest.approx(1.8, rel=0.05) and 0.9 < view.read().mean() and view.read().max() <= 1
    plain = build(recorded[0], calibration, tmp_path / "plain", white=1.0)
    assert plain.views[0].read().min() > 0.999


def test_a_flat_field_of_another_camera_is_refused_before_anything_moves(recorded, tmp_path):
    other = session("rgb8")
    with open_rig("sim_flawed", other, scene="grey_card", seed=0, time_scale=200.0, radiometry=recorded[1]) as rig:
        before = rig.robot.state().joints
        with pytest.raises(UsageError, match="response for another pixel format"):
            record(other, rig, tmp_path / "rec")
        assert np.abs(rig.robot.state().joints - before).max() < 1e-3
    assert not (tmp_path / "rec").exists()


def test_a_session_with_a_response_is_not_resumed_without_one(recorded, tmp_path):
    """The camera would no longer keep its black level, and the response would be wrong for the rest."""
    import shutil

    shutil.copytree(recorded[0], tmp_path / "copy")
    Recording.open(tmp_path / "copy").discard(["001"])
    trajectory = session("bayer12", "camera.brackets=2", "camera.exposure_us=30000", "camera.bracket_factor=6")
    options = {"scene": "grey_card", "seed": 0, "time_scale": 200.0}
    with open_rig("sim_flawed", trajectory, **options) as rig:
        with pytest.raises(UsageError, match=r"another black level .1\.56 % .*now 0\.00 %.*--radiometry .*radiometry\.npz"):
            record(trajectory, rig, tmp_path / "copy", resume=True)
    with open_rig("sim_flawed", trajectory, **options, radiometry=tmp_path / "copy" / "radiometry.npz") as rig:
        record(trajectory, rig, tmp_path / "copy", resume=True)
    assert len(Recording.open(tmp_path / "copy").frames) == 2


def test_a_changed_flat_field_is_refused(recorded, calibration, tmp_path):
    import shutil

    shutil.copytree(recorded[0], tmp_path / "copy")
    with open(tmp_path / "copy" / "radiometry.npz", "ab") as file:
        file.write(b"0")
    with pytest.raises(DatasetError, match="not the response that was recorded"):
        build(tmp_path / "copy", calibration, tmp_path / "scene")
    assert build(tmp_path / "copy", calibration, tmp_path / "scene", radiometry=recorded[1]).views
    assert not list(tmp_path.glob(".developing*"))


def test_a_grey_camera_works_from_recording_to_scene(calibration, tmp_path):
    trajectory = session("mono8")
    with open_rig("sim", trajectory, scene="grey_card", seed=0, time_scale=200.0) as rig:
        record(trajectory, rig, tmp_path / "recording")
    assert not check(tmp_path / "recording")[1:]  # a card has no sharpness to compare
    view = build(tmp_path / "recording", calibration, tmp_path / "scene").views[0]
    assert images.channels(view.image) == 1 and view.read().shape == (64, 96, 3)
    assert images.linear_from_srgb(view.read()).mean() == pytest.approx(0.6, rel=0.01)
    assert pose.inverse(view.world_from_camera).shape == (4, 4)
