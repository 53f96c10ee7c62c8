"""Triangulation of rays that are known exactly: no pictures."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import View
from koala3d.datasets.structure.matching import Matches, ViewFeatures
from koala3d.datasets.structure.triangulate import agreement, endless_share, explained, triangulate

CAMERA = Camera(640, 480, 600.0, 600.0, 320.0, 240.0)


def made(points: np.ndarray, count: int = 6) -> tuple[Matches, np.ndarray]:
    """Cameras on an arc of radius 4 that all see all points, each matched with all others."""
    angles = np.deg2rad(np.linspace(-25, 25, count))
    matrices = np.stack(
        [pose.look_at((4 * np.sin(a), 0.3 * np.cos(7 * a), -4 * np.cos(a)), (0, 0, 0), (0, -1, 0)) for a in angles]
    )
    features = []
    for matrix in matrices:
        local = (points - matrix[:3, 3]) @ matrix[:3, :3]
        features.append(
            ViewFeatures(
                local / local[:, 2:], np.zeros((len(points), 128), np.float32), np.ones((len(points), 3), np.float32), 1 / 600
            )
        )
    index = np.stack([np.arange(len(points))] * 2, axis=1)
    pairs = tuple((i, j, index) for i in range(count) for j in range(i + 1, count))
    views = tuple(View(str(i), CAMERA, matrix, "train", Path("none")) for i, matrix in enumerate(matrices))
    return Matches(views, tuple(features), pairs), matrices


def test_exact_rays_meet_in_their_points() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    matches, matrices = made(points)
    cloud = triangulate(matches, matrices)
    order = np.lexsort(cloud.points.T.round(6))
    assert np.abs(cloud.points[order] - points[np.lexsort(points.T.round(6))]).max() < 1e-9
    assert (np.bincount(cloud.sightings[:, 0]) == 6).all() and cloud.errors_px.max() < 1e-9
    assert agreement(matches, matrices) == 1.0 and endless_share(matches, matrices, 0.1) == 0.0


def test_a_view_that_errs_is_dropped_and_the_point_stays() -> None:
    """One ray of six is five pixels off across the epipolar lines' direction and along it."""
    points = np.random.default_rng(1).uniform(-1, 1, (20, 3))
    matches, matrices = made(points)
    matches.features[2].directions[7, :2] += [5 / 600, 0.0]
    cloud = triangulate(matches, matrices)
    nearest = np.linalg.norm(cloud.points[:, None] - points[None], axis=-1).min(0)
    assert nearest.max() < 1e-6 and 2 not in cloud.sightings[np.bincount(cloud.sightings[:, 0])[cloud.sightings[:, 0]] == 5, 1]
    assert (np.bincount(cloud.sightings[:, 0]) == 5).sum() == 1


def test_two_views_are_not_enough() -> None:
    matches, matrices = made(np.repeat([[0.1], [0.2], [0.3]], 3, axis=1), count=2)
    assert len(triangulate(matches, matrices).points) == 0 and agreement(matches, matrices) == 1.0


def test_points_behind_a_camera_are_not_explained() -> None:
    """Positions mirrored, rays as they were: they stay in their planes, but meet behind."""
    matches, matrices = made(np.random.default_rng(2).uniform(-1, 1, (10, 3)))
    assert explained(matches, matches.pairs[0], matrices).all()  # the premise
    mirrored = matrices.copy()
    mirrored[:, :3, 3] *= -1
    assert not explained(matches, matches.pairs[0], mirrored).any()


@pytest.mark.parametrize(("distance", "expected"), [(20.0, 0.0), (5000.0, 1.0)])
def test_distant_points_have_no_parallax(distance: float, expected: float) -> None:
    points = np.random.default_rng(3).uniform(-0.2, 0.2, (30, 3)) * distance + [0, 0, distance]
    matches, matrices = made(points)
    assert endless_share(matches, matrices, 0.3) == expected


def test_without_matches_there_are_no_points() -> None:
    matches, matrices = made(np.zeros((0, 3)))
    assert len(triangulate(matches, matrices).points) == 0 and agreement(matches, matrices) == 0.0
