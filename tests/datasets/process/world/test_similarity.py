"""Similarities: exact recovery, composition, and the rotation that makes a direction point up."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.process.world.similarity import Similarity, between, upwards
from koala3d.datasets.scene import View


@pytest.fixture
def some() -> Similarity:
    return Similarity(2.5, pose.from_rotation_vector([0.3, -1.0, 0.4])[:3, :3], np.array([1.0, -2.0, 3.0]))


def test_points_give_their_similarity_back(some: Similarity) -> None:
    source = np.random.default_rng(0).normal(size=(7, 3))
    found = between(source, some.points(source))
    np.testing.assert_allclose(found.points(source), some.points(source), atol=1e-12)
    assert found.scale == pytest.approx(2.5, abs=1e-12) and np.linalg.det(found.rotation) == pytest.approx(1)


def test_points_in_a_plane_are_not_mirrored(some: Similarity) -> None:
    source = np.random.default_rng(1).normal(size=(6, 3)) * [1, 1, 0]
    found = between(source, some.points(source))
    np.testing.assert_allclose(found.rotation, some.rotation, atol=1e-9)


def test_a_view_moves_with_the_points_it_sees(some: Similarity) -> None:
    camera = Camera(100, 80, 90, 90, 50, 40)
    view = View("a", camera, pose.look_at((0, 0, -4), (0, 0, 0), up=(0, -1, 0)), "train", Path("none"))
    points = np.random.default_rng(2).uniform(-1, 1, (5, 3))
    moved = some.view(view)

    def pixels(view: View, points: np.ndarray) -> np.ndarray:
        return camera.project((points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3])

    np.testing.assert_allclose(pixels(moved, some.points(points)), pixels(view, points), atol=1e-9)


def test_one_after_the_other(some: Similarity) -> None:
    other = Similarity(0.5, upwards([1, 2, 3]), np.array([0.0, 1.0, 0.0]))
    points = np.random.default_rng(3).normal(size=(4, 3))
    np.testing.assert_allclose(some.after(other).points(points), some.points(other.points(points)), atol=1e-12)


@pytest.mark.parametrize("up", [(0, 0, 2), (0, 0, -1), (1, 0, 0), (0.2, -0.5, 0.3)])
def test_up_becomes_z(up: tuple) -> None:
    rotation = upwards(up)
    np.testing.assert_allclose(rotation @ up, [0, 0, np.linalg.norm(up)], atol=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
