"""Folders that are almost a scene are answered by what is there, what is missing, and a command."""

from collections.abc import Callable
from pathlib import Path

import pytest

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import detect, load_scene, save_scene
from koala3d.datasets.scene import Scene


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ([], "it is empty"),
        (["a/b.txt", "c.dat"], r"it holds a/, c\.dat; no cameras\.json.*give the folder that holds one of these"),
        (["frames.jsonl"], "it is a recording.*datasets build .*photos --calibration FILE --out photos_scene"),
        (["run.json"], "it is a run.*reconstruct view "),
        (
            ["transforms_present.json"],
            r"transforms_present\.json is there, .*transforms\.json is not.*cp .*transforms_present\.json",
        ),
        (["my_poses_bounds.npy"], r"poses_bounds\.npy is not.*cp "),
        (["cameras_sphere.npz"], "cameras_sphere.npz is there, a folder of images is not.*put the images into .*image"),
        (["cameras_old.npz", "image/0.png"], "cameras_sphere.npz is not.*cp "),
        (["database.db", "images/a.jpg"], "a model is not.*colmap mapper --database_path .*database.db --image_path .*images"),
        (["a.jpg", "b.jpg"], r"it holds 2 images and no poses.*datasets process .*photos --out photos_scene"),
        (["rgb/a.jpg"], r"it holds 1 images and no poses.*datasets process .*photos/rgb --out photos_scene"),
        (["walk.MOV"], r"is a video without poses.*datasets process .*walk\.MOV"),
    ],
)
def test_what_is_missing_is_named(tmp_path: Path, names: list[str], words: str) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    with pytest.raises(UsageError, match=f"photos: holds no scene in a known format.*{words}") as caught:
        detect(folder)
    assert "\n" not in str(caught.value)


def test_a_scene_in_an_inner_folder_is_named(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    save_scene(make_scene(truth=False, count=3), tmp_path / "outer" / "data" / "my scene", "nerfstudio")
    with pytest.raises(UsageError, match=r"there is one in data/my scene\); datasets info '.*/outer/data/my scene'"):
        load_scene(tmp_path / "outer")


def test_a_part_of_a_model_is_named(tmp_path: Path) -> None:
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    (tmp_path / "sparse" / "0" / "images.bin").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"sparse/0: COLMAP model is not complete \(cameras\.bin is missing\)"):
        detect(tmp_path)
