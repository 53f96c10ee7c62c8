"""Masks are found under the names of other programs, or it is said why not."""

from pathlib import Path

import pytest

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats.finding import masks


def touch(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return folder


NAMES = ["b.JPG", "a.JPG"]


@pytest.mark.parametrize(
    "form",
    [
        "masks/{stem}.png", "masks/{stem}.jpg", "masks/{stem}.JPG", "masks/{stem}.JPG.png", "masks/{stem}.jpg.PNG",
        "masks/{stem}_mask.png", "masks/mask_{stem}.png", "mask/{stem}.png", "Masks/{stem}.tif", "masks_2/{stem}.png",
        "alpha/{stem}.png", "images_mask/{stem}.png", "object_masks/{stem}.png", "silhouettes/{stem}.png",
        "images/{stem}_mask.png",
    ],
)  # fmt: skip
def test_masks_are_found_by_name(tmp_path: Path, form: str) -> None:
    touch(tmp_path, *(f"images/{name}" for name in NAMES), *(form.format(stem=stem) for stem in "abc"))
    found, note = masks.find(tmp_path, tmp_path / "images", NAMES)
    assert found == [tmp_path / form.format(stem=stem) for stem in "ba"] and not note


def test_masks_of_the_images_size_come_first(tmp_path: Path) -> None:
    touch(tmp_path, *(f"{home}/{stem}.png" for home in ("masks", "masks_2", "masks_4", "alpha_4") for stem in "ab"))
    for home, expected in (("images", "masks"), ("images_4", "masks_4"), ("images_8", "masks")):
        found, _ = masks.find(tmp_path, tmp_path / home, ["a.jpg"])
        assert found == [tmp_path / expected / "a.png"]


def test_masks_with_names_of_their_own_follow_the_order_of_names(tmp_path: Path) -> None:
    touch(tmp_path, "mask/000.png", "mask/001.png", "masks_of_others/x.png")
    found, note = masks.find(tmp_path, tmp_path / "image", ["000001.png", "000000.png"])
    assert found == [tmp_path / "mask/001.png", tmp_path / "mask/000.png"] and not note
    found, note = masks.find(tmp_path, tmp_path / "image", ["IMG_7.png", "IMG_3.png"])
    assert found == [tmp_path / "mask/001.png", tmp_path / "mask/000.png"] and "order of names" in note


def test_masks_in_folders_of_cameras(tmp_path: Path) -> None:
    touch(tmp_path, "masks/left/a.jpg.png", "masks/right/a.jpg.png")
    found, _ = masks.find(tmp_path, tmp_path / "images", ["right/a.jpg", "left/a.jpg"])
    assert found == [tmp_path / "masks/right/a.jpg.png", tmp_path / "masks/left/a.jpg.png"]


def test_masks_of_nothing_are_named_with_the_remedy(tmp_path: Path) -> None:
    touch(tmp_path, "masks/x.png", "masks/y.png", "masks/z.png")
    words = (
        r"masks: no mask is named after an image \(2 images; it holds 3 such as x.png\); name the mask of b.JPG b.png or b.JPG"
    )
    with pytest.raises(DatasetError, match=words):
        masks.find(tmp_path, tmp_path / "images", NAMES)


@pytest.mark.parametrize("names", [["alpha/x.png"], ["masks/readme.txt"], ["images/a_mask.png"]])
def test_what_is_no_folder_of_masks_is_left_alone(tmp_path: Path, names: list[str]) -> None:
    touch(tmp_path, *names)
    assert masks.find(tmp_path, tmp_path / "images", NAMES) == ([None, None], "")


def test_some_missing_masks_stay_missing(tmp_path: Path) -> None:
    touch(tmp_path, "masks/a.png")
    assert masks.find(tmp_path, tmp_path / "images", NAMES)[0] == [None, tmp_path / "masks/a.png"]
