"""The photographs of a folder: names, cameras, focal lengths by EXIF, orientation, and folders that hold too few."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.process.pictures import exif, features, upright
from koala3d.datasets.process.pictures.photographs import cameras, find
from tests.foreign import photographs

PICTURE = photographs.corners(60, 40)


def shoot(path: Path, picture: NDArray[np.uint8] = PICTURE, **header: photographs.Header) -> None:
    photographs.write(path, picture, **header)


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
    photographs.write(tmp_path / "Pillow.jpg", PICTURE, FocalLengthIn35mmFilm=26, FocalLength=4.25, Make="Koala", Model="One")
    photographs.write_with_opencv(tmp_path / "OpenCV.jpg", PICTURE, FocalLengthIn35mmFilm=26)
    photographs.write(tmp_path / "Pillow.png", PICTURE, FocalLengthIn35mmFilm=26)
    found = [photograph.focal_px for photograph in find(tmp_path).photographs]
    assert found == pytest.approx([26 * np.hypot(60, 40) / np.hypot(36, 24)] * 3)


def test_the_focal_length_comes_from_the_focal_plane_otherwise(tmp_path: Path) -> None:
    """40 pixels an inch; in a copy at half the size, the header still states the width of the picture as it was taken."""
    said = {"FocalLength": 50.0, "FocalPlaneXResolution": 40.0, "FocalPlaneResolutionUnit": 2}
    shoot(tmp_path / "a.jpg", **said)
    shoot(tmp_path / "b.jpg", **said, ExifImageWidth=120)
    shoot(tmp_path / "c.jpg", FocalLength=50.0)
    full, half, unknown = (photograph.focal_px for photograph in find(tmp_path).photographs)
    assert full == pytest.approx(50 * 40 / 25.4) and half == pytest.approx(50 * 40 / 25.4 / 2) and unknown is None


def test_a_focal_length_that_is_no_number_is_unknown() -> None:
    assert exif.focal_length({"Exif:FocalLengthIn35mmFilm": 0, "Exif:FocalLength": "unknown"}, 6000, 4000) is None


def test_pictures_of_one_camera_share_it(tmp_path: Path) -> None:
    shoot(tmp_path / "a.jpg", Model="One", FocalLength=4.2)
    shoot(tmp_path / "b.jpg", Model="One", FocalLength=4.2)
    shoot(tmp_path / "c.jpg", Model="Two", FocalLength=4.2)
    shoot(tmp_path / "d.jpg", PICTURE[:20], Model="One", FocalLength=4.2)
    shoot(tmp_path / "e.jpg", Model="One", FocalLength=8.4)
    found = find(tmp_path).photographs
    assert cameras(found, "auto") == [0, 0, 1, 2, 3]
    assert cameras(found, "size") == [0, 0, 0, 1, 0]
    assert cameras(found, "each") == [0, 1, 2, 3, 4]


def test_turned_pictures_are_searched_upright(tmp_path: Path) -> None:
    """One picture, stored in all eight ways: it has one camera, one focal length, and its features where they are seen."""
    smooth = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (160, 240, 3), dtype=np.uint8), (0, 0), 1.5)
    picture = np.asarray(cv2.normalize(smooth, np.zeros_like(smooth), 0, 255, cv2.NORM_MINMAX), np.uint8)
    for orientation in photographs.ORIENTATIONS:
        shoot(tmp_path / f"{orientation}.jpg", picture, orientation=orientation, FocalLengthIn35mmFilm=26)
    found = find(tmp_path).photographs
    assert len(found) == 8 and {(photograph.width, photograph.height) for photograph in found} == {(240, 160)}
    assert [photograph.focal_px for photograph in found] == pytest.approx([26 * np.hypot(240, 160) / np.hypot(36, 24)] * 8)
    assert cameras(found, "auto") == [0] * 8
    copied, notes = upright.copies(find(tmp_path), tmp_path / "upright")
    assert notes == ("7 pictures are turned upright, as their EXIF orientation says",)
    first, *turned = (features.detect(photograph.path) for photograph in copied.photographs)
    assert len(first.pixels) > 50
    for again in turned:
        assert (again.width, again.height) == (240, 160)
        distances = np.linalg.norm(first.pixels[:50, None] - again.pixels[None], axis=-1).min(1)
        assert np.median(distances) < 0.3  # different noise of the two encodings


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
