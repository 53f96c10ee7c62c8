"""Damage a good recording in every way, and see it named."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter1d

from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.recording.check import check, to_take_again
from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Frame, Recording

COUNT, SIZE = 8, (96, 120)


def picture(index: int) -> np.ndarray:
    rng = np.random.default_rng(index)
    plates = np.kron(rng.uniform(0.1, 0.9, (8, 10, 3)), np.ones((12, 12, 1)))
    return (255 * gaussian_filter(plates, (0.6, 0.6, 0)) + rng.normal(0, 1, plates.shape)).clip(0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    changes = [
        "views=[{kind: orbit, target: [0.4, 0, 0.14], distance: 0.4, count: 8}]",
        "split=null",
        "camera.width=120",
        "camera.height=96",
    ]
    trajectory = load_trajectory("koala_demo", overrides=changes)
    path = tmp_path_factory.mktemp("good") / "recording"
    region = {"width": SIZE[1], "height": SIZE[0], "offset_x": 0, "offset_y": 0, "binning": 4}
    recording = Recording.create(path, {"trajectory": trajectory.model_dump(mode="json"), "camera": {"region": region}})
    for index in range(COUNT):
        name = f"{index:03d}"
        now, image = 1.7 * index, f"images/{name}.png"
        images.write(path / image, picture(index))
        reached, digest = pose.look_at((0.4, 0, 0.5), (0, 0, 0)), files.sha256(path / image)
        clocks = (100 + now, int(1e9 * (7 + now)), int(1e9 * (3 + now)))
        recording.append(
            Frame(
                index=index,
                name=name,
                split="train",
                image=image,
                base_from_flange=reached,
                joints=np.zeros(6),
                robot_time_s=clocks[0],
                host_time_ns=clocks[1],
                device_ticks=clocks[2],
                exposure_us=10_000.0,
                settle_s=0.4,
                sha256=digest,
            )
        )
    return path


@pytest.fixture
def recording(good, tmp_path) -> Path:
    return shutil.copytree(good, tmp_path / "recording")


def replace_image(path: Path, name: str, pixels: np.ndarray) -> None:
    """As if the camera had delivered this picture: the record's hash is that of the new file."""
    images.write(path / "images" / f"{name}.png", pixels)
    change_line(path, int(name), sha256=files.sha256(path / "images" / f"{name}.png"))


def change_line(path: Path, index: int, **values: object) -> None:
    lines = (path / "frames.jsonl").read_text().splitlines()
    lines[index] = json.dumps({**json.loads(lines[index]), **values})
    (path / "frames.jsonl").write_text("\n".join(lines) + "\n")


def found(path: Path) -> list[tuple[str, str, bool]]:
    return [(finding.frame, finding.what, finding.again) for finding in check(path)]


def test_a_good_recording_has_no_findings(good):
    seen = []
    assert check(good, done=lambda count, total: seen.append((count, total))) == []
    assert seen == [(count, COUNT) for count in range(1, COUNT + 1)]


def test_images_that_are_gone_changed_or_cut_off(recording):
    (recording / "images" / "001.png").unlink()
    data = bytearray((recording / "images" / "002.png").read_bytes())
    data[len(data) // 2] ^= 1
    (recording / "images" / "002.png").write_bytes(data)
    (recording / "images" / "003.png").write_bytes(data[:300])
    change_line(recording, 3, sha256=files.sha256(recording / "images" / "003.png"))
    replace_image(recording, "004", picture(4)[:50])
    assert found(recording) == [
        ("001", "its image is missing", True),
        ("002", "its image has changed", True),
        ("003", "its image cannot be read", True),
        ("004", "its image has another size", True),
    ]


def test_frames_that_are_missing_double_or_strange(recording):
    lines = (recording / "frames.jsonl").read_text().splitlines(keepends=True)
    strange = lines[4].replace('"004"', '"999"')
    (recording / "frames.jsonl").write_text("".join([*lines[:4], lines[3], strange, *lines[5:]]))
    named = {(frame, what) for frame, what, _ in found(recording)}
    assert {("004", "was never taken"), ("003", "was taken more than once"), ("999", "is not a view of the trajectory")} <= named


def test_clocks_and_gaps(recording):
    change_line(recording, 5, robot_time_s=50.0)
    for index in (6, 7):
        change_line(recording, index, host_time_ns=int(1e9 * (7 + 1.7 * index + 60)))
    assert found(recording) == [("005", "robot_time_s starts again", False), ("006", "was taken after a gap", False)]
    assert all(finding.note for finding in check(recording))
    change_line(recording, 3, device_ticks=int(1e9 * (3 + 1.7 * 2)))
    assert to_take_again(check(recording)) == ["003"]  # the same tick twice: the same picture twice


def test_an_arm_that_moved_during_an_exposure(recording):
    was = pose.look_at((0.4, 0, 0.5), (0, 0, 0))
    for index, (shift_m, turn_rad) in enumerate([(9e-5, 0.0), (1.2e-4, 0.0), (0.0, 1e-4), (0.0, 3e-4)]):
        moved = was @ pose.from_rotation_vector([0, turn_rad, 0], [shift_m, 0, 0])
        after = {"joints_after": [0.0] * 6, "robot_time_after_s": 100.1}
        change_line(recording, index, base_from_flange_after=moved.tolist(), **after)
    moved = "the arm moved during the exposure"
    assert found(recording) == [("001", moved, True), ("003", moved, True)]
    assert "by 0.12 mm and 0.000 degrees" in check(recording)[0].line


def test_exposure(recording):
    replace_image(recording, "001", np.clip(picture(1).astype(int) * 3, 0, 255).astype(np.uint8))
    replace_image(recording, "002", picture(2) // 12)
    change_line(recording, 3, exposure_us=5000.0)
    words = {frame: (what, again) for frame, what, again in found(recording)}
    assert words["001"] == ("is over-exposed", True) and words["002"] == ("is under-exposed", True)
    assert words["003"] == ("has another exposure time", True)


def test_an_exposure_that_the_camera_rounded_is_no_fault(recording):
    path = recording / "manifest.json"
    content = files.read_json(path)
    files.write_json(path, content | {"camera": {**content["camera"], "exposure_us": 9100.0}})
    for index in range(len(Recording.open(recording).frames)):
        change_line(recording, index, exposure_us=9100.0)
    assert found(recording) == []


@pytest.mark.parametrize("axis", [0, 1])
def test_blur(recording, axis):
    replace_image(recording, "006", uniform_filter1d(picture(6), 5, axis=axis))
    assert found(recording) == [("006", "is blurred", True)]


def test_discarded_frames_are_gone_and_the_others_untouched(recording):
    (recording / "images" / "001.png").unlink()
    replace_image(recording, "006", uniform_filter1d(picture(6), 5, axis=0))
    again = to_take_again(check(recording))
    assert again == ["001", "006"] and Recording.open(recording).discard(again) == again
    left = Recording.open(recording)
    assert [frame.name for frame in left.frames] == ["000", "002", "003", "004", "005", "007"]
    assert not (recording / "images" / "006.png").exists()
    assert {(frame, what) for frame, what, _ in found(recording)} == {("001", "was never taken"), ("006", "was never taken")}
    assert Recording.open(recording).discard(again) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"trajectory": None}, "the manifest has no trajectory"),
        ({"trajectory": {"name": "squares"}}, "manifest.json, trajectory: key 'views' is missing"),
        ({"trajectory": {"name": "squares", "views": [{"kind": "spiral"}]}}, "manifest.json, trajectory: "),
        ({"camera": {"region": {"width": "wide"}}}, "sensor region is not complete"),
        ({"camera": {"region": [1, 2]}}, "sensor region is not complete"),
    ],
)
def test_a_wrong_manifest_is_named_in_one_line(recording, change, words):
    path = recording / "manifest.json"
    files.write_json(path, files.read_json(path) | change)
    with pytest.raises(KoalaError, match=words) as caught:
        check(recording)
    assert "\n" not in str(caught.value)


def test_a_recording_that_does_not_say_its_region_is_checked_without_it(recording):
    path = recording / "manifest.json"
    files.write_json(path, files.read_json(path) | {"camera": "none"})
    assert found(recording) == []
