"""Features of a picture: where they are, what they look like, how they are stored; every kind of file."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images
from koala3d.datasets.process.pictures import features, markers

DOTS = np.array([[60.5, 40.5], [140.5, 70.5], [100.5, 120.5], [30.5, 110.5], [170.5, 130.5]])
"""Centres of round dots [px], first pixel's centre at 0.5."""


@pytest.fixture(scope="module")
def dots() -> NDArray[np.float32]:
    """(160, 200, 3) dark Gaussian dots of four pixels on light ground, each of its own colour."""
    x, y = np.meshgrid(np.arange(200) + 0.5, np.arange(160) + 0.5)
    picture = np.full((160, 200, 3), 0.9, np.float32)
    for k, (column, row) in enumerate(DOTS):
        shape = np.exp(-((x - column) ** 2 + (y - row) ** 2) / (2 * 4.0**2))
        picture -= (shape[..., None] * (0.7 - 0.3 * np.eye(3)[k % 3])).astype(np.float32)
    return picture


def nearest(found: features.PictureFeatures) -> NDArray[np.float64]:
    """(5,) distance of the nearest feature from each dot's centre."""
    return np.linalg.norm(found.pixels[:, None] - DOTS, axis=-1).min(0)


def test_features_are_where_the_dots_are(dots: NDArray[np.float32], tmp_path: Path) -> None:
    """Without the bias of OpenCV's default, a quarter of a pixel."""
    images.write(tmp_path / "a.png", dots)
    found = features.detect(tmp_path / "a.png")
    assert (found.width, found.height) == (200, 160) and found.descriptors.shape == (len(found.pixels), 128)
    assert nearest(found).max() < 0.1
    first = np.linalg.norm(found.pixels - DOTS[0], axis=-1).argmin()
    assert found.colours[first].argmax() == 0 and found.colours[first].min() < 100  # the first dot is reddish
    norms = np.linalg.norm(found.descriptors.astype(float), axis=1)
    np.testing.assert_allclose(norms, 512, rtol=0.02)  # roots of shares that sum to 1, rounded


@pytest.mark.parametrize("kind", ["16 bits.png", "floats.exr", "grey.png", "lossy.jpg"])
def test_every_kind_of_file_gives_the_same_features(dots: NDArray[np.float32], tmp_path: Path, kind: str) -> None:
    stored = {
        "16 bits.png": images.to_uint16(dots),
        "floats.exr": images.linear_from_srgb(dots),
        "grey.png": images.to_uint8(dots.mean(-1)),
    }.get(kind, images.to_uint8(dots))
    images.write(tmp_path / kind, stored)
    assert nearest(features.detect(tmp_path / kind)).max() < 0.2  # JPEG moves features by a tenth of a pixel


def test_transparent_parts_have_no_features(dots: NDArray[np.float32], tmp_path: Path) -> None:
    alpha = np.ones((160, 200, 1), np.float32)
    alpha[:, 120:] = 0
    images.write(tmp_path / "a.png", np.concatenate([dots, alpha], -1))
    found = features.detect(tmp_path / "a.png")
    assert len(found.pixels) and found.pixels[:, 0].max() < 121
    distances = nearest(found)
    assert distances[[0, 2, 3]].max() < 0.2 and distances[[1, 4]].min() > 10


def test_large_pictures_are_searched_at_a_smaller_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(features, "SIDE", 100)
    picture = np.random.default_rng(0).integers(0, 255, (300, 200, 3), dtype=np.uint8)
    images.write(tmp_path / "a.png", picture)
    found = features.detect(tmp_path / "a.png")
    assert (found.width, found.height) == (67, 100) and (found.pixels < [67, 100]).all()


def test_a_plain_picture_has_none(tmp_path: Path) -> None:
    images.write(tmp_path / "a.png", np.full((80, 100, 3), 99, np.uint8))
    found = features.detect(tmp_path / "a.png")
    assert found.pixels.shape == (0, 2) and found.descriptors.shape == (0, 128) and found.colours.shape == (0, 3)


def test_a_file_gives_the_features_back(tmp_path: Path) -> None:
    printed = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), 5, 80)
    picture = np.pad(printed, 40, constant_values=255)
    images.write(tmp_path / "a.png", picture)
    found = features.detect(tmp_path / "a.png")
    assert [marker.kind for marker in found.markers] == ["APRILTAG_36h11 5"]
    np.testing.assert_allclose(found.markers[0].corners, [[40, 40], [120, 40], [120, 120], [40, 120]], atol=0.6)
    found.save(tmp_path / "a.npz")
    again = features.PictureFeatures.load(tmp_path / "a.npz")
    for key in ("pixels", "descriptors", "colours", "width", "height"):
        np.testing.assert_array_equal(getattr(again, key), getattr(found, key))
    assert [marker.kind for marker in again.markers] == ["APRILTAG_36h11 5"]
    np.testing.assert_array_equal(again.markers[0].corners, found.markers[0].corners)
    (tmp_path / "a.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:100])
    with pytest.raises(DatasetError):
        features.PictureFeatures.load(tmp_path / "a.npz")


@pytest.mark.parametrize("name", ["DICT_4X4_50", "DICT_5X5_100", "DICT_6X6_250", "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_25h9"])
def test_markers_of_every_dictionary_are_found(name: str) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    picture = np.pad(cv2.aruco.generateImageMarker(dictionary, 9, 90), 30, constant_values=255)
    kinds = [marker.kind for marker in markers.detect(picture)]
    assert len(kinds) == 1 and kinds[0].endswith(" 9") and kinds[0].startswith(name.removeprefix("DICT_").rsplit("_", 1)[0])
