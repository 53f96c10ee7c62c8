"""The photographs of a folder: names, cameras, focal lengths by EXIF, orientation, and folders that hold too few."""

from pathlib import Path

import numpy as np
import pytest

from datasets.core.errors import UsageError
from datasets.imaging import images
from datasets.process.pictures import exif, features
from datasets.process.pictures.photographs import cameras, find

PICTURE = np.random.default_rng(0).integers(0, 255, (40, 60, 3), dtype=np.uint8)


def shoot(path: Path, picture: np.ndarray = PICTURE, **header: str | int | float) -> None:
    images.write(path, picture, metadata={key.replace("_", ":"): value for key, value in header.items()})


def test_pictures_of_every_suffix_are_found_and_others_named(tmp_path: Path) -> None:
    for name in ("b.JPG", "a.png", "c 1.jpeg", "Zürich.tif"):
        shoot(tmp_path / name)
    (tmp_path / "film.mov").write_bytes(b"")
    (tmp_path / ".hidden.jpg").write_bytes(b"")
    found = find(tmp_path)
    assert [photograph.name for photograph in found.photographs] == ["Zürich", "a", "b", "c 1"]
    assert found.ignored == ("film.mov",) and not found.damaged


def test_two_files_of_one_stem_get_two_names(tmp_path: Path) -> None:
    for name in ("a.jpg", "a.png", "b.png"):
        shoot(tmp_path / name)
    assert [photograph.name for photograph in find(tmp_path).photographs] == ["a_jpg", "a_png", "b"]


def test_a_damaged_header_is_named(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        shoot(tmp_path / name)
    (tmp_path / "d.jpg").write_bytes(b"\xff\xd8\xff nothing")
    (tmp_path / "e.jpg").write_bytes(b"")
    found = find(tmp_path)
    assert len(found.photographs) == 3 and set(found.damaged) == {"d.jpg", "e.jpg"}
    assert "the file is empty" in found.damaged["e.jpg"]


def test_the_focal_length_comes_from_the_equivalent_on_film(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        shoot(tmp_path / name, Exif_FocalLengthIn35mmFilm=26, Make="Koala", Model="One")
    focal = find(tmp_path).photographs[0].focal_px
    assert focal == pytest.approx(26 * np.hypot(60, 40) / np.hypot(36, 24))


def test_the_focal_length_comes_from_the_focal_plane_otherwise() -> None:
    header = {"Exif:FocalLength": 50.0, "Exif:FocalPlaneXResolution": 4000.0, "Exif:FocalPlaneResolutionUnit": 2}
    assert exif.focal_length(header, 6000, 4000) == pytest.approx(50 * 4000 / 25.4)
    assert exif.focal_length(header | {"Exif:PixelXDimension": 6000}, 1500, 1000) == pytest.approx(50 * 1000 / 25.4)
    assert exif.focal_length({"Exif:FocalLength": 50.0}, 6000, 4000) is None
    assert exif.focal_length({"Exif:FocalLengthIn35mmFilm": 0, "Exif:FocalLength": "unknown"}, 6000, 4000) is None


def test_pictures_of_one_camera_share_it(tmp_path: Path) -> None:
    shoot(tmp_path / "a.jpg", Model="One", Exif_FocalLength=4.2)
    shoot(tmp_path / "b.jpg", Model="One", Exif_FocalLength=4.2)
    shoot(tmp_path / "c.jpg", Model="Two", Exif_FocalLength=4.2)
    shoot(tmp_path / "d.jpg", PICTURE[:20], Model="One", Exif_FocalLength=4.2)
    shoot(tmp_path / "e.jpg", Model="One", Exif_FocalLength=8.4)
    photographs = find(tmp_path).photographs
    assert cameras(photographs, "auto") == [0, 0, 1, 2, 3]
    assert cameras(photographs, "size") == [0, 0, 0, 1, 0]
    assert cameras(photographs, "each") == [0, 1, 2, 3, 4]


def test_a_turned_picture_is_searched_upright(tmp_path: Path) -> None:
    """Orientation 6: the camera was held on its side, and the picture has to be turned clockwise."""
    import cv2

    smooth = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (300, 400, 3), dtype=np.uint8), (0, 0), 2)
    upright = cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX)  # type: ignore[call-overload]
    for name in ("a.jpg", "b.jpg"):
        shoot(tmp_path / name, upright)
    shoot(tmp_path / "c.jpg", np.ascontiguousarray(np.rot90(upright)), Orientation=6)
    first, _, turned = find(tmp_path).photographs
    assert (turned.width, turned.height) == (first.width, first.height) == (400, 300)
    seen, again = features.detect(first.path), features.detect(turned.path)
    distances = np.linalg.norm(seen.pixels[:50, None] - again.pixels[None], axis=-1).min(1)
    assert len(seen.pixels) > 50 and np.median(distances) < 0.3  # different noise of the two encodings


def test_a_folder_without_photographs_says_what_it_holds(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such folder or video"):
        find(tmp_path / "nowhere")
    with pytest.raises(UsageError, match=r"too few photographs.*0 pictures, 3 are needed"):
        find(tmp_path)
    for k in range(4):
        (tmp_path / f"IMG_{k}.HEIC").write_bytes(b"heic")
    with pytest.raises(UsageError, match=r"4 files \.heic: convert them to JPEG"):
        find(tmp_path)
    (tmp_path / "images").mkdir()
    for k in range(3):
        shoot(tmp_path / "images" / f"{k}.png")
    with pytest.raises(UsageError, match=r"give .*images"):
        find(tmp_path)
