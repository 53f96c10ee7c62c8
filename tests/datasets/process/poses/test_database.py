"""pycolmap's database: cameras, continued matching, pairs by a vocabulary tree; and why pictures stay without pose."""

import re
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.process.pictures import features, photographs
from koala3d.datasets.process.pictures.features import PictureFeatures
from koala3d.datasets.process.poses import database, reasons
from koala3d.datasets.process.poses.database import Picture

pycolmap = pytest.importorskip("pycolmap")


@pytest.fixture(scope="module")
def pictures(shots) -> list[Picture]:
    """Four of the photographs, two of each of two cameras."""
    found = photographs.find(shots.folder).photographs
    chosen = sorted(found, key=lambda photograph: list(shots.poses).index(photograph.name))[:4]
    return [Picture(k + 1, f"{k + 1:06d}.png", p, k // 2, features.detect(p.path)) for k, p in enumerate(chosen)]


@pytest.fixture
def path(pictures: list[Picture], tmp_path: Path) -> Path:
    database.write(tmp_path / "a.db", pictures)
    return tmp_path / "a.db"


def test_pictures_share_cameras_and_keep_their_features(pictures: list[Picture], path: Path) -> None:
    with pycolmap.Database.open(path) as stored:
        assert stored.num_cameras() == 2 and stored.num_images() == stored.num_frames() == 4
        images = stored.read_all_images()
        assert [image.name for image in images] == [picture.file for picture in pictures]
        assert images[0].camera_id == images[1].camera_id != images[2].camera_id
        np.testing.assert_array_equal(stored.read_keypoints(1)[:, :2], pictures[0].features.pixels)
        camera = stored.read_camera(1)
    assert camera.focal_length == pytest.approx(1.2 * 400) and not camera.has_prior_focal_length


def test_matching_continues_where_it_stopped(pictures: list[Picture], path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database, "BLOCK", 2)
    seen: list[tuple[int, int]] = []
    database.match(path, pictures, [(0, 1), (1, 2), (2, 3)], done=lambda k, n: seen.append((k, n)))
    assert seen == [(2, 3), (3, 3)]
    before = database.links(path)
    assert set(before) == {(1, 2), (2, 3), (3, 4)} and min(before.values()) > 100
    with pycolmap.Database.open(path) as stored:
        stored.delete_matches(1, 2)
        stored.delete_inlier_matches(1, 2)
    database.match(path, pictures, [(0, 1), (1, 2), (2, 3)])
    after = database.links(path)
    assert set(after) == set(before) and all(after[pair] == before[pair] for pair in ((2, 3), (3, 4)))


def test_a_vocabulary_tree_chooses_pairs(pictures: list[Picture], path: Path, tmp_path: Path) -> None:
    all_of_them = np.concatenate([picture.features.descriptors for picture in pictures])
    words = pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, all_of_them).to_float()
    index = pycolmap.VisualIndex.create(128, 64)
    options = pycolmap.VisualIndex.BuildOptions(num_visual_words=64, num_iterations=5, num_rounds=1)  # rough, and soon made
    index.build(options, words)
    index.write(tmp_path / "tree.bin")
    found = database.by_vocabulary(path, tmp_path / "tree.bin")
    assert {(0, 1), (1, 2), (2, 3)} <= set(found) and all(0 <= i < j < 4 for i, j in found)
    (tmp_path / "no.bin").write_bytes(b"no tree" * 100)
    with pytest.raises(UsageError, match=re.escape("no.bin: is no vocabulary tree")):
        database.by_vocabulary(path, tmp_path / "no.bin")


def picture_with(count: int, pictures: list[Picture]) -> Picture:
    none = np.zeros((count, 2), np.float32)
    found = PictureFeatures(9, 9, none, np.zeros((count, 128), np.uint8), np.zeros((count, 3), np.uint8), ())
    return Picture(9, "000009.png", pictures[0].photograph, 0, found)


def test_reasons_name_the_first_step_that_failed(pictures: list[Picture]) -> None:
    groups = [["000001.png"], ["000009.png", "000002.png"]]
    assert "too few features (7)" in reasons.of(picture_with(7, pictures), {(1, 9): 80}, groups)
    many = picture_with(500, pictures)
    assert "too few matches" in reasons.of(many, {(1, 2): 80}, groups)
    assert "in a group of 2 pictures" in reasons.of(many, {(1, 9): 80}, groups)
    assert "did not fit: up to 80 matches with 2 pictures" in reasons.of(many, {(1, 9): 80, (2, 9): 30}, groups[:1])
