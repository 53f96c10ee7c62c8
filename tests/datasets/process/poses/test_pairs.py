"""Which pictures are matched: all of few, those that look alike of many, neighbours in a row."""

from itertools import combinations

import numpy as np
import pytest

from koala3d.datasets.process.pictures.features import PictureFeatures
from koala3d.datasets.process.poses import pairs
from koala3d.datasets.process.poses.looks import likeliest, looks


def pictures_of(scenes: list[int]) -> list[PictureFeatures]:
    """Pictures with 60 features each, of which those of one scene share 30."""
    random = np.random.default_rng(0)
    known = {scene: random.integers(0, 120, (30, 128), dtype=np.uint8) for scene in sorted(set(scenes))}
    result = []
    for scene in scenes:
        own = random.integers(0, 120, (30, 128), dtype=np.uint8)
        descriptors = random.permutation(np.concatenate([known[scene] + random.integers(0, 4, (30, 128), dtype=np.uint8), own]))
        none = np.zeros((60, 2), np.float32)
        result.append(PictureFeatures(100, 80, none, descriptors, np.zeros((60, 3), np.uint8), ()))
    return result


def test_pictures_of_one_scene_look_alike() -> None:
    scenes = [0, 1, 0, 2, 1, 0, 2]
    found = pairs.alike(pictures_of(scenes))
    assert found == [(i, j) for i, j in combinations(range(7), 2) if scenes[i] == scenes[j]]


def test_a_picture_without_features_looks_like_none() -> None:
    empty = PictureFeatures(9, 9, np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8), np.zeros((0, 3), np.uint8), ())
    assert pairs.alike([*pictures_of([0, 0]), empty]) == [(0, 1)]


def test_neighbours_are_matched_at_growing_distances() -> None:
    found = pairs.neighbours(200)
    assert len(found) == len(set(found)) and all(0 <= i < j < 200 for i, j in found)
    assert sorted(j - i for i, j in found if i == 0) == [1, 2, 3, 4, 5, 6, 7, 8, 16, 32, 64]


@pytest.mark.parametrize(
    ("kind", "in_order", "count"),
    [("all", False, 10), ("auto", False, 10), ("alike", False, 4), ("neighbours", False, 10), ("alike", True, 10)],
)
def test_the_choice_follows_the_kind(kind: str, in_order: bool, count: int) -> None:
    found = pairs.choose(pictures_of([0, 1, 0, 1, 0]), kind, in_order=in_order)
    assert len(found) == count and found == sorted(set(found))


def test_many_pictures_are_not_matched_each_with_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pairs, "MOST_ALL", 4)
    seen: list[int] = []
    assert len(pairs.choose(pictures_of([0, 1, 0, 1, 0]), "auto", in_order=False, done=lambda: seen.append(1))) == 4
    assert len(seen) == 5


def test_pictures_of_one_scene_have_the_nearest_vectors() -> None:
    """Among those of three scenes, the two others of the same one; a picture without features has no place to be near to."""
    made = pictures_of([0, 1, 2, 0, 1, 2, 0, 1, 2])
    assert likeliest(made, 2) == {(i, j) for i in range(9) for j in range(i + 1, 9) if i % 3 == j % 3}
    assert np.allclose(np.linalg.norm(looks(made), axis=1), 1)
