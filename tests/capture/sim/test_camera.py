from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.model.flaws import Flaws
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.recording.focus import sharpness
from koala3d.capture.sim.camera import SimulatedCamera, blur_moments
from koala3d.capture.sim.laboratory.views import check_scene
from koala3d.capture.sim.truth import RigTruth
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images

TRUTH = RigTruth.draw(np.eye(4), 0)


def looking(trajectory: Trajectory) -> np.ndarray:
    """`base_from_flange` from which the true camera looks at the object."""
    centre = np.asarray(trajectory.object.centre if trajectory.object else (0.45, 0, 0))
    return pose.look_at(np.add(centre, (-0.4, -0.1, 0.3)), centre) @ pose.inverse(TRUTH.flange_from_camera)


class ArmAt:
    """An arm that stands still, or turns about the camera's y axis at `speed` [rad/s]."""

    def __init__(self, base_from_flange: np.ndarray, speed: float = 0.0) -> None:
        self.base_from_flange, self.speed = base_from_flange, speed

    def exposed(self, exposure_s: float, count: int) -> np.ndarray:
        angles = self.speed * exposure_s * (np.arange(count) + 0.5) / count
        turns = [pose.from_rotation_vector([0, angle, 0]) for angle in angles]
        to_camera = TRUTH.flange_from_camera
        if not self.speed:
            return np.stack([self.base_from_flange] * count)
        return np.stack([self.base_from_flange @ to_camera @ turn @ pose.inverse(to_camera) for turn in turns])


@pytest.fixture
def trajectory() -> Trajectory:
    small = ["camera.width=120", "camera.height=120", "camera.binning=4"]
    return load_trajectory("koala_demo", overrides=small)


def simulated(trajectory: Trajectory, scene: str = "shiny_ball", seed: int = 0) -> SimulatedCamera:
    return SimulatedCamera(trajectory, scene, TRUTH, ArmAt(looking(trajectory)), seed)


def test_truth_of_a_test_view_is_that_of_its_picture(trajectory, tmp_path):
    with simulated(trajectory) as camera:
        camera.prepare(3)
        pixels = camera.grab().pixels
        camera.save_truth(tmp_path, "003", "test")
    maps = {
        channel: images.read(next((tmp_path / channel).iterdir()))
        for channel in ("alpha", "normals", "depth", "diffuse", "specular")
    }
    whole = images.srgb_from_linear(np.clip(maps["diffuse"] + maps["specular"], 0, 1))
    assert np.sqrt(np.mean((whole - pixels / 255) ** 2)) < 0.01  # sensor noise and eight bits
    object_only = maps["alpha"][..., 0] > 0.999
    assert 0.1 < object_only.mean() < 0.9  # the premise: object and surroundings are both seen
    beside = maps["alpha"][..., 0] == 0
    assert maps["diffuse"][object_only].max() < 0.03 and maps["specular"][beside].max() < 0.03  # half a fine pixel at the rim
    assert maps["diffuse"][object_only].mean() < 1e-4 and maps["specular"][beside].mean() < 1e-4
    np.testing.assert_allclose(np.linalg.norm(maps["normals"][object_only], axis=-1), 1, atol=1e-5)
    assert (maps["depth"][object_only] > 0.2).all() and (maps["depth"][object_only] < 0.7).all()
    _check_ball(maps, object_only, tmp_path)


def _check_ball(maps: dict[str, np.ndarray], inside: np.ndarray, folder: Path) -> None:
    """Pixels, depth and pose lead back to a sphere, and normals point away from its centre."""
    content = files.read_json(folder / "poses.json", kind="koala-truth", version=1)
    camera, base_from_camera = Camera.from_json(content["camera"], where="truth"), np.array(content["base_from_camera"]["003"])
    points = camera.directions(camera.pixel_centres())[inside] * maps["depth"][inside]
    points = points @ base_from_camera[:3, :3].T + base_from_camera[:3, 3]
    import trimesh

    ball = trimesh.load(folder / "object.ply")
    centre, radius = ball.bounds.mean(0), ball.extents[0] / 2
    outward = points - centre
    middle = np.einsum("ij,ij->i", outward / radius, maps["normals"][inside]) > 0.9  # not where a pixel spans much depth
    assert middle.mean() > 0.9
    facing = maps["normals"][inside] @ base_from_camera[:3, 2] < -0.5
    distance = np.linalg.norm(outward[facing], axis=-1)
    assert np.abs(distance - radius).max() < 1e-3  # depth is a mean over pixels that are 1.6 mm wide on the ball


def test_train_views_keep_their_pose_only(trajectory, tmp_path):
    with simulated(trajectory) as camera:
        camera.grab()
        camera.save_truth(tmp_path, "000", "train")
        camera.save_truth(tmp_path, "001", "train")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["object.ply", "poses.json"]
    content = files.read_json(tmp_path / "poses.json")
    wanted = looking(trajectory) @ TRUTH.flange_from_camera
    assert sorted(content["base_from_camera"]) == ["000", "001"]
    np.testing.assert_allclose(content["base_from_camera"]["001"], wanted, atol=1e-12)
    np.testing.assert_array_equal(content["flange_from_camera"], TRUTH.flange_from_camera)


def test_noise_depends_on_seed_and_frame_and_on_nothing_before(trajectory):
    small = trajectory.model_copy(update={"camera": trajectory.camera.model_copy(update={"width": 32, "height": 32})})

    def pictures(seed: int, *frames: int) -> list[np.ndarray]:
        taken = []
        with simulated(small, seed=seed) as camera:
            for frame in frames:
                camera.prepare(frame)
                taken.append(camera.grab().pixels)
        return taken

    (resumed,), (_, seventh, eighth), (other,) = pictures(0, 7), pictures(0, 2, 7, 8), pictures(1, 7)
    assert np.array_equal(seventh, resumed)
    assert not np.array_equal(eighth, resumed) and not np.array_equal(other, resumed)


def test_scene_and_trajectory_must_suit_each_other(trajectory):
    calibration = load_trajectory("calibration_demo")
    with pytest.raises(UsageError, match="needs a trajectory with 'target'"):
        check_scene("board", trajectory)
    with pytest.raises(UsageError, match="needs a trajectory with 'object'"):
        check_scene("gold_head", calibration)
    check_scene("board", calibration)


def test_motion_during_the_exposure_blurs_the_picture():
    small = ["camera.width=160", "camera.height=120", "camera.binning=1", "camera.exposure_us=20000"]
    trajectory = load_trajectory("calibration_demo", overrides=small)
    truth = []

    def picture(speed: float) -> np.ndarray:
        above = pose.look_at((0.39, 0.01, 0.35), (0.40, 0.0, 0.0)) @ pose.inverse(TRUTH.flange_from_camera)
        with SimulatedCamera(trajectory, "board", TRUTH, ArmAt(above, speed), 0) as camera:
            pixels = camera.grab().pixels
            truth.append(camera.base_from_camera)
        return pixels

    still, slow, fast = (sharpness(picture(speed)) for speed in (0.0, 1e-4, 0.15))
    assert slow == still  # 0.003 px are not rendered
    assert fast < 0.8 * still  # 0.15 rad/s times 20 ms times 1270 px are 3.8 px
    turned = pose.difference(truth[0], truth[2])[1]
    assert turned == pytest.approx(0.15 * 0.020 / 2, rel=0.2)  # its pose is that of the middle


def test_as_many_moments_are_rendered_as_the_motion_needs():
    camera = Camera(200, 100, 1000.0, 1000.0, 100.0, 50.0)
    count = {}
    for angle in (0.0, 2e-5, 1e-3, 3e-3, 1.0):
        poses = [pose.from_rotation_vector([0, angle * share, 0]) for share in np.linspace(0, 1, 16)]
        count[angle] = len(blur_moments(camera, np.stack(poses)))
    assert [count[0.0], count[2e-5], count[1e-3], count[1.0]] == [1, 1, 3, 16] and 6 <= count[3e-3] <= 8


def above_the_board(pixel_format: str) -> np.ndarray:
    changes = ["camera.width=160", "camera.height=120", f"camera.pixel_format={pixel_format}"]
    trajectory = load_trajectory("calibration_demo", overrides=changes)
    above = pose.look_at((0.39, 0.01, 0.35), (0.40, 0.0, 0.0)) @ pose.inverse(TRUTH.flange_from_camera)
    with SimulatedCamera(trajectory, "board", TRUTH, ArmAt(above), 0) as camera:
        return camera.grab().pixels


def test_raw_photosites_give_nearly_the_same_picture():
    colours, raw8, raw12 = (above_the_board(name) for name in ("rgb8", "bayer8", "bayer12"))
    assert colours.dtype == raw8.dtype == np.uint8 and raw12.dtype == np.uint16
    for raw in (raw8, raw12):
        difference = raw / np.iinfo(raw.dtype).max - colours / 255
        assert np.median(np.abs(difference)) < 0.02  # edges differ, where colours had to be guessed


def test_twelve_bits_have_the_steps_of_twelve_bits():
    raw8, raw12 = (above_the_board(name) for name in ("bayer8", "bayer12"))
    assert len(np.unique(raw8)) <= 256 < 1000 < len(np.unique(raw12)) <= 4096


def test_binning_leaves_the_brightness_whatever_the_camera_does(trajectory):
    """A camera that adds columns up takes a quarter of the time; both see what single pixels do."""
    seen = []
    for binning, flaws in ((1, Flaws()), (4, Flaws()), (4, Flaws(sums_columns=True))):
        settings = trajectory.camera.model_copy(update={"binning": binning, "pixel_format": "bayer12", "width": 48, "height": 48})
        binned = trajectory.model_copy(update={"camera": settings})
        with SimulatedCamera(binned, "grey_card", TRUTH, ArmAt(looking(trajectory)), 0, flaws) as camera:
            seen.append(camera.grab())
    assert [image.exposure_us for image in seen] == [10_010, 10_010, 2_485]
    light = [np.median(image.raw) for image in seen]
    assert light[1] == pytest.approx(light[0], rel=0.02) and light[2] == pytest.approx(light[1] * 4 * 2_485 / 10_010, rel=0.01)


def test_a_shorter_exposure_sees_the_same_light(trajectory):
    """Brackets: light is rendered once, and the values scale with the time."""
    with simulated(
        trajectory.model_copy(update={"camera": trajectory.camera.model_copy(update={"pixel_format": "bayer12"})})
    ) as camera:
        longer = camera.grab()
        camera.set_exposure(trajectory.camera.exposure_us / 4)
        shorter = camera.grab()
    assert longer.raw.shape == (120, 120) and longer.raw.dtype == np.uint16
    assert (longer.exposure_us, shorter.exposure_us) == (10_010, 2_485)
    usable = (longer.raw > 400) & (longer.raw < 3900)
    assert usable.mean() > 0.3  # the premise
    assert np.median(longer.raw[usable] / np.maximum(shorter.raw[usable], 1)) == pytest.approx(10_010 / 2_485, rel=0.005)
