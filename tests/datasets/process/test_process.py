"""From rendered photographs to a scene: accuracy, resuming, what is left out, and clear refusals."""

import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.checks.check import check
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.process.pictures import features
from koala3d.datasets.process.poses import database, mapping
from koala3d.datasets.process.process import Processed, Request, process
from koala3d.datasets.process.work import Work
from koala3d.datasets.process.world import similarity
from koala3d.datasets.process.world.alignment import Wishes
from koala3d.datasets.process.world.scale import KnownLength
from koala3d.datasets.scene import Scene

pytest.importorskip("pycolmap")

CAMERA = Camera(400, 300, 420.0, 421.0, 203.0, 147.0, k1=-0.04)
"""Of the photographs, as in `conftest`."""
SIDE_M = 0.24


def off(scene: Scene, truth: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Errors of position, in shares of the distance to the origin, and of direction [deg] after alignment by a similarity."""
    found = similarity.between([v.world_from_camera[:3, 3] for v in scene.views], [truth[v.name][:3, 3] for v in scene.views])
    views = [found.view(view) for view in scene.views]
    by_pose = [pose.difference(view.world_from_camera, truth[view.name]) for view in views]
    distance, angle = np.array(by_pose).T
    return distance / [np.linalg.norm(truth[view.name][:3, 3]) for view in views], np.rad2deg(angle)


@pytest.fixture(scope="module")
def finished(shots, tmp_path_factory: pytest.TempPathFactory) -> tuple[Processed, Path]:
    """The scene of the ten photographs by its marker; three more are damaged, without texture, and of another place."""
    folder = tmp_path_factory.mktemp("scene")
    photos = folder / "photos"
    shutil.copytree(shots.folder, photos)
    whole = (photos / "my photo 0.png").read_bytes()
    (photos / "cut off.png").write_bytes(whole[: len(whole) // 2])
    images.write(photos / "grey.png", np.full((300, 400, 3), 128, np.uint8))
    noise = np.random.default_rng(1).integers(0, 255, (75, 100, 3), dtype=np.uint8)
    images.write(photos / "elsewhere.png", np.kron(noise, np.ones((4, 4, 1), np.uint8)))
    (photos / "notes.txt").write_text("no picture")
    return process(photos, folder / "table", Request(), Wishes(marker_m=SIDE_M)), folder / "table"


def test_poses_are_those_of_the_cameras(finished, shots) -> None:
    scene = load_scene(finished[1])
    assert {view.name for view in scene.views} == set(shots.poses)
    distance, angle = off(scene, shots.poses)
    assert distance.max() < 0.005 and angle.max() < 0.3  # what is asked of real photographs
    assert finished[0].error_px < 0.5


def test_the_lens_is_that_of_the_camera(finished) -> None:
    found = {view.camera for view in load_scene(finished[1]).views}
    assert len(found) == 1
    camera = found.pop()
    assert [camera.fx, camera.fy] == pytest.approx([CAMERA.fx, CAMERA.fy], rel=0.01)
    assert [camera.cx, camera.cy] == pytest.approx([CAMERA.cx, CAMERA.cy], abs=3.0)  # as far as ten small pictures tell
    assert camera.k1 == pytest.approx(CAMERA.k1, abs=0.02) and camera.p1 == camera.p2 == 0


def test_the_marker_gives_metres_and_up(finished, shots) -> None:
    scene = load_scene(finished[1])
    assert scene.metric and "4X4_1000 7" in finished[0].aligned.scale_from
    places = {view.name: view.world_from_camera[:3, 3] for view in scene.views}
    first, *_, last = shots.poses
    true = np.linalg.norm(shots.poses[first][:3, 3] - shots.poses[last][:3, 3])
    assert np.linalg.norm(places[first] - places[last]) == pytest.approx(
        true, rel=0.02
    )  # corners of a marker of 60 px, to 0.5 px
    heights = np.array([places[name][2] - matrix[2, 3] for name, matrix in shots.poses.items()])
    assert np.ptp(heights) < 0.05 and abs(heights).max() < 0.05  # z is up and 0 on the table


def test_the_scene_has_points_bounds_and_a_test_split(finished) -> None:
    scene = load_scene(finished[1])
    assert scene.points is not None and scene.sightings is not None and len(scene.colours) == len(scene.points)
    assert len(scene.points) > 300 and abs(np.median(scene.points[:, 2])) < 0.1
    assert scene.bounds_from == f"{len(scene.points)} points of the model" and 0.5 < scene.near < 2.0
    assert [view.split for view in scene.views] == ["test" if k % 8 == 0 else "train" for k in range(10)]
    assert not [finding.line for finding in check(finished[1]) if finding.level == "error"]


def test_what_is_left_out_is_named_with_the_reason(finished) -> None:
    result, out = finished
    assert result.given == 13 and set(result.left_out) == {"cut off.png", "grey.png", "elsewhere.png"}
    assert "cannot be read" in result.left_out["cut off.png"]
    assert "too few features" in result.left_out["grey.png"]
    assert "too few matches" in result.left_out["elsewhere.png"]
    assert "3 of 13 pictures are left out" in load_scene(out).notes[0]
    ignored, turned = load_scene(out).notes[1:]
    assert ignored == "files of other kinds are not read: notes.txt"
    assert "3 pictures are turned upright, as their EXIF orientation says" in turned
    assert not out.with_name("table.work").exists()


class Stop(Exception):
    """What ends a step halfway."""


@pytest.fixture(scope="module")
def six(shots, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of six of the photographs, neighbours on the arc: a third of the pairs of all ten."""
    folder, chosen = tmp_path_factory.mktemp("six"), list(shots.poses)[2:8]
    for path in shots.folder.iterdir():
        if path.stem in chosen:
            shutil.copy(path, folder)
    return folder


def test_an_interrupted_call_continues(six: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is ended in each of its steps in turn; what was finished before is not done again."""
    out, work = tmp_path / "scene", Work(tmp_path / "scene")
    detected = []
    whole = features.detect

    def counted(path: Path) -> features.PictureFeatures:
        if len(detected) == 3:
            raise Stop
        detected.append(path.name)
        return whole(path)

    with monkeypatch.context() as patch:
        patch.setattr(features, "detect", counted)
        with pytest.raises(Stop):
            process(six, out, Request(), Wishes())
    assert len(list(work.features.glob("*.npz"))) == 3 and not out.exists()

    whole_match = database.match

    def ended(path: Path, pictures: list, pairs: list, **_: object) -> None:
        whole_match(path, pictures, pairs[:5])
        raise Stop

    with monkeypatch.context() as patch:
        patch.setattr(database, "match", ended)
        patch.setattr(features, "detect", lambda path: detected.append(path.name) or whole(path))
        with pytest.raises(Stop):
            process(six, out, Request(), Wishes())
    assert sorted(detected) == sorted(path.name for path in six.iterdir())
    assert 0 < len(database.links(work.database)) <= 5

    with monkeypatch.context() as patch:
        patch.setattr(mapping, "refine", lambda model: (_ for _ in ()).throw(Stop))
        patch.setattr(features, "detect", None)
        with pytest.raises(Stop):
            process(six, out, Request(), Wishes())
    assert not work.model.exists() and not out.exists()

    with pytest.raises(UsageError, match="no picture called 'x' was placed"):
        process(six, out, Request(), Wishes(known=_length("x:1,1+y:2,2")))
    assert work.model.is_dir()
    with monkeypatch.context() as patch:
        patch.setattr(mapping, "build", None)
        assert process(six, out, Request(), Wishes()).resumed
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene"]


def test_a_killed_process_leaves_what_the_next_one_needs(six: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out, work = tmp_path / "scene", Work(tmp_path / "scene")
    command = [sys.executable, "-m", "koala3d.datasets.cli", "process", str(six), "--out", str(out)]
    with (tmp_path / "said").open("w") as said:
        running = subprocess.Popen(command, stderr=said)
        while running.poll() is None and len(list(work.features.glob("0*.npz"))) < 2:
            time.sleep(0.02)
        running.kill()
        running.wait()
    kept = list(work.features.glob("0*.npz"))
    assert len(kept) >= 2 and not out.exists(), (tmp_path / "said").read_text()
    detected = []
    whole = features.detect
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(features, "detect", lambda path: detected.append(path) or whole(path))
        found = process(six, out, Request(), Wishes())
    assert found.resumed and len(found.aligned.scene.views) == 6 and len(detected) == 6 - len(kept)
    assert f"continuing in {work.folder}" in capfd.readouterr().err


def test_other_choices_keep_the_features_and_other_pictures_do_not(tmp_path: Path) -> None:
    work = Work(tmp_path / "scene")
    assert not work.start(["a"], ["all"])
    work.features.mkdir()
    work.model.mkdir(parents=True)
    work.database.write_bytes(b"")
    assert work.start(["a"], ["all"]) and work.model.exists()
    assert not work.start(["a"], ["alike"])
    assert work.features.exists() and not work.model.exists() and not work.database.exists()
    assert not work.start(["b"], ["alike"]) and not work.features.exists()


def test_pictures_of_different_places_do_not_overlap(tmp_path: Path) -> None:
    """The refusal comes again the second time, from what is known already."""
    random = np.random.default_rng(0)
    for k in range(4):
        picture = random.integers(0, 255, (75, 100, 3), dtype=np.uint8)
        images.write(tmp_path / "photos" / f"{k}.png", np.kron(picture, np.ones((4, 4, 1), np.uint8)))
    for _ in range(2):
        with pytest.raises(DatasetError, match="do not overlap enough for poses"):
            process(tmp_path / "photos", tmp_path / "scene", Request(), Wishes())


def _length(end: str) -> KnownLength:
    return KnownLength.parse(end, end, 1.0)
