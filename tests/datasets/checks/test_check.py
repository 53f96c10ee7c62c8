import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.checks.check import check, summary
from koala3d.datasets.formats import koala, load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene


@pytest.fixture
def saved(make_scene: Callable[..., Scene], tmp_path: Path) -> Path:
    koala.save(make_scene(), tmp_path / "scene")
    return tmp_path / "scene"


def altered(path: Path, change: Callable[[list], None]) -> None:
    """Change the views in a cameras.json in place; NaN is written as a careless program would."""
    content = json.loads((path / "cameras.json").read_text())
    change(content["views"])
    (path / "cameras.json").write_text(json.dumps(content))


def lines(path: Path) -> list[str]:
    found = [finding.line for finding in check(path)]
    assert all("\n" not in line for line in found)
    return found


def test_a_sound_scene_has_no_findings(saved: Path) -> None:
    seen = []
    assert check(saved, done=lambda count, total: seen.append((count, total))) == []
    assert seen[-1] == (9, 9)


def test_damaged_files_are_found_all_at_once(saved: Path) -> None:
    (saved / "images" / "001.png").unlink()
    whole = (saved / "images" / "002.png").read_bytes()
    (saved / "images" / "002.png").unlink()
    (saved / "images" / "002.png").write_bytes(whole[: len(whole) // 2])
    for name, size in (("003", (72, 90, 3)), ("005", (72, 96, 3))):
        (saved / "images" / f"{name}.png").unlink()
        images.write(saved / "images" / f"{name}.png", np.full(size, 0.5))
    (saved / "truth" / "depth" / "004.exr").unlink()
    (saved / "images" / "007.png").unlink()
    (saved / "images" / "007.png").write_bytes((saved / "images" / "006.png").read_bytes())
    found = lines(saved)
    for words in (
        "001.png: no such image",
        "002.png: image cannot be read",
        "003.png (view 003): image has the wrong size",
        "005.png: image has one colour only",
        "004.exr: no such image",
        "view 007: image is the same as another's (equal to view 006)",
    ):
        assert any(words in line for line in found), (words, found)
    assert len(found) == 6


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda views: views[3]["world_from_camera"][0].__setitem__(3, float("nan")),
            "view 3 (003), world_from_camera: pose is not finite",
        ),
        (lambda views: views[3]["world_from_camera"][0].__setitem__(0, -views[3]["world_from_camera"][0][0]), "pose is"),
        (lambda views: views[3]["camera"].__setitem__("fx", -1), "view 3 (003), camera: camera has no size or no focal length"),
        (lambda views: views[3].__setitem__("image", "../../secret.png"), "leaves the folder"),
        (lambda views: views[3].__setitem__("split", "exam"), "no split called 'exam'"),
        (lambda views: views[3].pop("camera"), "view is not complete"),
        (lambda views: views[3].__setitem__("name", "004"), "view is listed twice"),
    ],
)
def test_impossible_views_are_named_and_the_rest_is_checked(saved: Path, change: Callable, words: str) -> None:
    altered(saved, change)
    found = lines(saved)
    assert any(words in line for line in found), found


def test_cameras_that_look_away_or_stand_apart(saved: Path) -> None:
    def turn(views: list) -> None:
        matrix = np.array(views[2]["world_from_camera"]) @ pose.from_rotation_vector((0, np.pi, 0))
        views[2]["world_from_camera"] = matrix.tolist()
        views[4]["world_from_camera"][0][3] += 100.0

    altered(saved, turn)
    found = lines(saved)
    assert any("view 002: camera looks away" in line for line in found)
    assert any("view 004: camera is far from all others" in line for line in found)
    assert not any("view 003" in line for line in found)


def test_all_on_one_spot(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = make_scene()
    views = tuple(replace(v, world_from_camera=pose.rigid(v.world_from_camera[:3, :3], (0, 0, 0.3))) for v in scene.views)
    koala.save(scene.with_views(views), tmp_path / "scene")
    assert any("all cameras stand on one spot" in line for line in lines(tmp_path / "scene"))


def test_a_folder_without_images(saved: Path) -> None:
    altered(saved, lambda views: views.clear())
    assert lines(saved) == [f"error: {saved}: scene has no images (cameras.json lists none); put the images in place"]


def test_an_empty_mask_is_found(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = make_scene(mask=True)
    images.write(scene.views[2].mask, np.zeros((72, 96), np.uint8))
    koala.save(scene, tmp_path / "scene")
    assert lines(tmp_path / "scene") == ["warning: view 002: mask or alpha is empty; check the mask, or drop the view"]


def test_a_test_picture_that_is_nearly_a_training_picture(saved: Path) -> None:
    """Written again with noise of one grey level: other bytes, another pose, the same picture."""
    picture = images.read(saved / "images" / "003.png")
    noise = np.random.default_rng(0).normal(0, 1 / 255, picture.shape)
    (saved / "images" / "004.png").unlink()
    images.write(saved / "images" / "004.png", picture + noise)
    found = lines(saved)
    assert len(found) == 1 and "view 004: test picture is nearly a training picture (it differs from view 003 by 0." in found[0]


def test_summary_counts(saved: Path) -> None:
    found = summary(load_scene(saved))
    assert found["views"] == {"train": 6, "val": 0, "test": 3} and found["truth"] == {"alpha": 3, "depth": 3, "normals": 3}
    assert found["far"] is None and found["metric"] is True
    json.dumps(found, allow_nan=False)
