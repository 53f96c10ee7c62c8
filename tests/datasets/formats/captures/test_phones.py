"""Captures of Polycam, Record3D and 3D Scanner App: ARKit's axes, improved poses, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import detect, load_scene
from koala3d.datasets.imaging import images

WIDTH, HEIGHT = 64, 48
FX, FY, CX, CY = 55.0, 55.5, 31.0, 24.5


def arkit(k: int) -> np.ndarray:
    """(4, 4) world_from_camera of ARKit: y of the world up; the camera looks along its own -z, from 2 m at the origin."""
    angle = 0.5 * k
    away = np.array([np.sin(angle), 0.3, np.cos(angle)]) / np.hypot(1, 0.3)
    right = np.cross([0, 1, 0], away) / np.linalg.norm(np.cross([0, 1, 0], away))
    return pose.rigid(np.stack([right, np.cross(away, right), away], axis=1), 2 * away)


def picture(path: Path, k: int) -> None:
    images.write(path, np.full((HEIGHT, WIDTH, 3), 20 + 30 * k, np.uint8))


def of_polycam(folder: Path, *, corrected: bool = True, count: int = 4) -> Path:
    for kind in ("", *(["corrected_"] if corrected else [])):
        for k in range(count):
            moved = arkit(k)
            moved[0, 3] += 0.0 if kind or not corrected else 0.05  # the phone's own tracking drifts
            rows = {f"t_{i}{j}": moved[i, j] for i in range(3) for j in range(4)}
            camera = {"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": WIDTH, "height": HEIGHT, "blur_score": 80, **rows}
            home = folder / "keyframes" / f"{kind}cameras"
            home.mkdir(parents=True, exist_ok=True)
            (home / f"{1000 + k}.json").write_text(json.dumps(camera))
            picture(folder / "keyframes" / f"{kind}images" / f"{1000 + k}.jpg", k)
    return folder


def of_record3d(folder: Path, count: int = 11) -> Path:
    poses = []
    for k in range(count):
        w, x, y, z = pose.quaternion(arkit(k))
        poses.append([x, y, z, w, *arkit(k)[:3, 3]])
        picture(folder / "EXR_RGBD" / "rgb" / f"{k}.jpg", k % 7)
    content = {"w": WIDTH, "h": HEIGHT, "K": [FX, 0, 0, 0, FY, 0, CX, CY, 1], "fps": 30, "poses": poses}
    (folder / "EXR_RGBD" / "metadata.json").write_text(json.dumps(content))
    return folder


def of_scanner(folder: Path, count: int = 11) -> Path:
    """Every frame has its pose, every second its picture; depth and what else the program writes lie beside them."""
    folder.mkdir(parents=True)
    (folder / "info.json").write_text('{"title": "scan"}')
    for k in range(2 * count):
        matrix = arkit(k // 2) if k % 2 == 0 else np.eye(4)
        content = {
            "cameraPoseARFrame": matrix.reshape(-1).tolist(),
            "intrinsics": [FX, 0, CX, 0, FY, CY, 0, 0, 1],
            "projectionMatrix": np.eye(4).reshape(-1).tolist(),
            "frame_index": k,
            "time": 0.1 * k,
        }
        (folder / f"frame_{k:05d}.json").write_text(json.dumps(content))
        images.write(folder / f"depth_{k:05d}.png", np.zeros((8, 8, 1), np.uint16))
        if k % 2 == 0:
            picture(folder / f"frame_{k:05d}.jpg", k // 2 % 7)
    return folder


@pytest.mark.parametrize("write", [of_polycam, of_record3d, of_scanner])
def test_cameras_see_what_is_in_front_of_them(tmp_path, write) -> None:
    folder = write(tmp_path / "capture")
    scene = load_scene(folder)
    assert detect(folder) == "phone" and scene.metric and len(scene.views) == (4 if write is of_polycam else 11)
    for k, view in enumerate(scene.views):
        local = pose.inverse(view.world_from_camera) @ [[0, 0], [0, 0.1], [0, 0], [1, 1]]
        middle, above = view.camera.project(local[:3].T)
        assert np.allclose(middle, [CX, CY]) and local[2, 0] == pytest.approx(2)
        assert above[0] == pytest.approx(CX) and above[1] < CY - 1, "up in the world is up in the picture"
        assert images.read_stored(view.image)[0, 0, 0] == pytest.approx(20 + 30 * (k % 7), abs=2)


def test_improved_poses_are_preferred_and_others_are_told(tmp_path) -> None:
    better = load_scene(of_polycam(tmp_path / "a"))
    assert np.allclose(better.views[0].world_from_camera[:3, 3], arkit(0)[:3, 3])
    assert not any("has not improved" in note for note in better.notes)
    assert any("has not improved" in note for note in load_scene(of_polycam(tmp_path / "b", corrected=False)).notes)


def test_missing_pictures_are_named_and_surplus_ones_refused(tmp_path) -> None:
    folder = of_record3d(tmp_path / "a")
    (folder / "EXR_RGBD" / "rgb" / "3.jpg").unlink()
    assert any("missing and left out: 03" in note for note in load_scene(folder).notes)
    picture(folder / "EXR_RGBD" / "rgb" / "11.jpg", 0)
    with pytest.raises(DatasetError, match=r"do not belong together \(11 poses, 11.jpg"):
        load_scene(folder)


def test_damaged_files_are_named(tmp_path) -> None:
    folder = of_polycam(tmp_path / "a")
    (folder / "keyframes" / "corrected_cameras" / "1001.json").write_text('{"fx": 1}')
    with pytest.raises(DatasetError, match=r"1001.json: camera is not complete"):
        load_scene(folder)
    frames = of_scanner(tmp_path / "c")
    (frames / "frame_00004.json").write_text('{"intrinsics": [1, 2], "cameraPoseARFrame": []}')
    with pytest.raises(DatasetError, match=r"frame_00004.json: frame is not complete"):
        load_scene(frames)
    other = of_record3d(tmp_path / "b")
    content = json.loads((other / "EXR_RGBD" / "metadata.json").read_text())
    content["poses"][2][3] = 5.0
    (other / "EXR_RGBD" / "metadata.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="not a unit quaternion"):
        load_scene(other)
