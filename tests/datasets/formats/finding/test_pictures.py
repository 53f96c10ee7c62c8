"""Folders of images and files in them under the names that other programs give them."""

from pathlib import Path

import pytest

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats.finding import pictures


def touch(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return folder


@pytest.mark.parametrize(
    ("names", "home", "count"),
    [
        (["images/a.JPG", "images/b.jpeg", "images/.hidden.jpg", "images/notes.txt"], "images", 2),
        (["image/a.png", "image_2/a.png"], "image", 1),
        (["rgb/a.PNG", "depth/a.png"], "rgb", 1),
        (["Images/a.png"], "Images", 1),
        (["images_8/a.png", "images_4/a.png", "images_4/b.png"], "images_4", 2),
        (["images/readme.txt", "images_2/a.png"], "images_2", 1),
        (["images/a.png", "images/a_mask.png", "images/mask_a.png", "images/depth_of_field.png"], "images", 2),
    ],
)
def test_the_largest_images_are_found(tmp_path: Path, names: list[str], home: str, count: int) -> None:
    found, name = pictures.find(touch(tmp_path, *names))
    assert name == home and len(found) == count


def test_a_folder_without_images_is_answered_by_what_is_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no folder of images \(there are the folders pics, sparse\)"):
        pictures.find(touch(tmp_path, "pics/a.png", "sparse/x"))
    with pytest.raises(DatasetError, match="scene has no images"):
        pictures.find(touch(tmp_path, "images/readme.txt"))
    with pytest.raises(DatasetError, match="leaves the folder"):
        pictures.find(tmp_path, "../elsewhere")


@pytest.mark.parametrize(
    ("there", "sought", "found"),
    [
        ("a.JPG", "a.jpg", "a.JPG"),
        ("a.png", "a.jpg", "a.png"),
        ("a.png", "a", "a.png"),
        ("frame.001.png", "frame.001", "frame.001.png"),
        ("deep/a.png", "deep/a.jpg", "deep/a.png"),
        ("ab.png", "a", None),
    ],
)
def test_a_file_is_found_whatever_its_suffix(tmp_path: Path, there: str, sought: str, found: str | None) -> None:
    touch(tmp_path, there, there.rsplit(".", 1)[0] + ".txt")
    assert pictures.Listing().like(tmp_path, sought) == (tmp_path / found if found else None)


def test_png_is_preferred_among_several(tmp_path: Path) -> None:
    assert pictures.Listing().like(touch(tmp_path, "a.exr", "a.jpg", "a.png"), "a") == tmp_path / "a.png"
