"""Surfels on shapes whose area, normals and thickness are known."""

import numpy as np
import trimesh
from scipy.spatial import KDTree

from koala3d.reconstruct.splats.surfels import WIDTH, cover

RADIUS = 0.1


def test_a_ball_is_covered_evenly_and_without_holes() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    found = cover(ball, 2000)
    assert 1600 < len(found.points) <= 2000
    outward = found.points / np.linalg.norm(found.points, axis=-1, keepdims=True)
    assert np.abs(np.linalg.norm(found.points, axis=-1) - RADIUS).max() < 1e-3 * RADIUS  # facets
    assert np.sum(found.normals * outward, -1).min() > 0.999
    assert np.allclose(found.rotations.swapaxes(1, 2) @ found.rotations, np.eye(3)) and np.all(np.linalg.det(found.rotations) > 0)
    nearest = KDTree(found.points).query(found.points, k=2)[0][:, 1]
    assert nearest.min() > 0.79 * np.sqrt(ball.area / 2000)  # the smallest distance
    assert found.scales[:, 0].max() < 2 * found.scales[:, 0].min()
    assert np.all(found.scales[:, 2] < 0.2 * found.scales[:, 0])
    passing = 1.0 - 0.99 * np.exp(-0.5 * (distances(found.points, outward_of(500)) / found.scales[:, 0]) ** 2)
    assert passing.prod(-1).max() < 0.06 and passing.prod(-1).mean() < 0.01  # light that gets through, seen from above


def outward_of(count: int) -> np.ndarray:
    towards = np.random.default_rng(1).normal(size=(count, 3))
    return RADIUS * towards / np.linalg.norm(towards, axis=-1, keepdims=True)


def distances(points: np.ndarray, places: np.ndarray) -> np.ndarray:
    return np.linalg.norm(places[:, None] - points, axis=-1)


def test_both_sides_of_a_thin_wall_are_covered() -> None:
    wall = trimesh.creation.box((0.1, 0.1, 1e-4))
    found = cover(wall, 1000)
    above = found.points[:, 2] > 0
    assert 0.4 < above.mean() < 0.6 and len(found.points) > 700
    flat = np.abs(found.normals[:, 2]) > 0.9
    assert np.array_equal(found.normals[flat, 2] > 0, above[flat])
    assert 0.5 * WIDTH < np.median(found.scales[:, 0]) / np.sqrt(wall.area / 1000) < 2 * WIDTH  # not that of a point behind


def test_the_same_mesh_gives_the_same_surfels() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
    assert np.array_equal(cover(ball, 300).points, cover(ball, 300).points)
