"""Which way is up: cameras held level, the ground among walls and clutter, markers."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.process.pictures.markers import PlacedMarker
from koala3d.datasets.process.world import up
from koala3d.datasets.process.world.similarity import upwards
from koala3d.datasets.scene import View

TILT = upwards([0.4, 0.5, 0.3]).T
"""Rotation of the whole scene; its third column is up."""


def cameras(places: np.ndarray, roll_deg: float = 0.0, target: tuple = (0, 0, 0)) -> list[View]:
    random, views = np.random.default_rng(0), []
    for k, place in enumerate(places):
        matrix = pose.look_at(place, target) @ pose.from_rotation_vector([0, 0, np.deg2rad(random.normal(scale=roll_deg))])
        turned = pose.rigid(TILT, np.zeros(3)) @ matrix
        views.append(View(str(k), Camera(100, 80, 90, 90, 50, 40), turned, "train", Path("none")))
    return views


def arc(degrees: float, elevation_deg: float, count: int = 20) -> np.ndarray:
    angle, height = np.deg2rad(np.linspace(0, degrees, count)), np.deg2rad(elevation_deg)
    return 2 * np.stack([np.cos(height) * np.cos(angle), np.cos(height) * np.sin(angle), np.full(count, np.sin(height))], -1)


def angle_deg(found: np.ndarray) -> float:
    return float(np.rad2deg(np.arccos(np.clip(found @ TILT[:, 2], -1, 1))))


@pytest.mark.parametrize(("degrees", "elevation"), [(360, 30), (90, 60), (60, 10)])
def test_level_cameras_tell_up(degrees: float, elevation: float) -> None:
    found = up.by_cameras(cameras(arc(degrees, elevation), roll_deg=2.0))
    assert angle_deg(found) < 3


def test_pictures_taken_in_one_direction_give_their_mean() -> None:
    places = np.array([[0.2 * k, -3.0, 0.1 * (k % 2)] for k in range(10)])
    views = [view for k, place in enumerate(places) for view in cameras(places[k : k + 1], target=(place[0], 0, place[2]))]
    found = up.by_cameras(views)
    assert angle_deg(found) < 1


def clutter(ground: int, wall: int, rest: int) -> np.ndarray:
    """Points of a ground at z = -0.5, of a larger wall behind it, and of things on the ground."""
    random = np.random.default_rng(1)
    flat = np.column_stack([random.uniform(-1, 1, (ground, 2)), np.full(ground, -0.5)])
    upright = np.column_stack([random.uniform(-2, 2, wall), np.full(wall, 2.5), random.uniform(-0.5, 2, wall)])
    things = random.uniform([-0.3, -0.3, -0.5], [0.3, 0.3, 0.4], (rest, 3))
    noise = random.normal(scale=0.003, size=(ground + wall + rest, 3))
    return (np.concatenate([flat, upright, things]) + noise) @ TILT.T


def test_the_ground_is_found_beside_a_larger_wall() -> None:
    views = cameras(arc(120, 30))
    guide = TILT @ pose.from_rotation_vector([0.2, 0.1, 0])[:3, 2]
    found = up.by_plane(views, clutter(300, 700, 400), guide)
    assert found is not None
    normal, place, share = found
    assert angle_deg(normal) < 1 and (TILT.T @ place)[2] == pytest.approx(-0.5, abs=0.01)
    assert share == pytest.approx(300 / 1400, abs=0.05)


def test_no_ground_no_plane() -> None:
    assert up.by_plane(cameras(arc(120, 30)), clutter(0, 700, 400), TILT[:, 2]) is None


def test_a_plane_above_the_cameras_is_no_ground() -> None:
    places = arc(120, 30) - [0, 0, 3]
    assert up.by_plane(cameras(places, target=(0, 0, -3)), clutter(300, 0, 400), TILT[:, 2]) is None


def test_markers_tell_up_unless_they_face_different_ways() -> None:
    square = np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    flat = PlacedMarker("a 1", square @ TILT.T, 5)
    upright = PlacedMarker("a 2", square[:, [0, 2, 1]] @ TILT.T, 5)
    found = up.by_markers([flat])
    assert found is not None and angle_deg(found[0]) < 1e-6 and "a printed marker" in found[1]
    assert up.by_markers([flat, upright]) is None and up.by_markers([]) is None
