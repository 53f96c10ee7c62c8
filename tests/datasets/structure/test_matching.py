from collections.abc import Callable

import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure import matching
from koala3d.datasets.structure.matching import ViewFeatures, match


def features(descriptors: np.ndarray) -> ViewFeatures:
    unit = (descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)).astype(np.float32)
    return ViewFeatures(np.zeros((len(unit), 3)), unit, np.zeros((len(unit), 3), np.float32), 1e-3)


def test_matches_are_mutual_and_clear() -> None:
    """Ten features in another order and with a little noise; one that has a double, and one that has no partner."""
    random = np.random.default_rng(0)
    known = random.random((12, 128)) ** 4
    order = random.permutation(10)
    second = known[order] + random.normal(0, 1e-3, (10, 128))
    second = np.concatenate([second, known[[10, 10]] + random.normal(0, 1e-2, (2, 128))])  # two that look like feature 10
    found = match(features(known), features(second))
    assert {(int(a), int(b)) for a, b in found} == {(int(order[k]), k) for k in range(10)}


def test_too_few_features_match_nothing() -> None:
    assert match(features(np.ones((1, 128))), features(np.ones((5, 128)))).shape == (0, 2)


def test_neighbours_are_near_but_not_the_same() -> None:
    angles = np.deg2rad([0, 0.5, 10, 20, 180])
    matrices = np.stack([pose.look_at((4 * np.cos(a), 4 * np.sin(a), 0), (0, 0, 0)) for a in angles])
    pairs = matching.neighbours(matrices, np.zeros(3), count=1)
    assert (0, 1) not in pairs and (2, 3) in pairs and (0, 2) in pairs


def test_features_are_where_the_pictures_show_the_same(two_walls: Callable[..., Scene]) -> None:
    """Matched rays of two views, the second's through the exact depth of the first's: half a pixel, whatever the lens."""
    scene = two_walls(Camera(200, 150, 220.0, 221.0, 101.0, 74.0, k1=-0.2, k2=0.05))
    one, other = (matching.detect(scene.views[i]) for i in (5, 6))
    pairs = match(one, other)
    assert len(pairs) > 100
    a, b = (scene.views[i].world_from_camera for i in (5, 6))
    rays = one.directions[pairs[:, 0]] @ a[:3, :3].T
    square = a[:3, 3] + rays * (-a[2, 3] / rays[:, 2:])
    depth = np.where((np.abs(square[:, :2]) < 0.8).all(1), 0.0, 2.0)
    points = a[:3, 3] + rays * ((depth - a[2, 3])[:, None] / rays[:, 2:])
    local = (points - b[:3, 3]) @ b[:3, :3]
    off = np.linalg.norm(local[:, :2] / local[:, 2:] - other.directions[pairs[:, 1], :2], axis=1) / other.pixel
    assert np.median(off) < 0.5
    assert one.light.min() >= 0 and one.light.max() <= 1 and one.light.std() > 0.01
