"""Frames of the light, told from the colours of points on a ball under known lamps."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import View
from koala3d.datasets.structure.light_frame import FRAMES, light_frames, normals, turntable
from koala3d.datasets.structure.matching import Matches, ViewFeatures
from koala3d.datasets.structure.triangulate import Cloud

CAMERA = Camera(200, 200, 250.0, 250.0, 100.0, 100.0)
TURN = pose.from_rotation_vector((0.4, -0.7, 0.2))
"""Nothing may depend on the axes of the world."""


def ball(frame: str, *, views: int = 24, lamp: float = 0.5, noise: float = 0.02) -> tuple[Matches, Cloud, np.ndarray]:
    """Points of a ball of random albedo, seen from two rings by the side that faces a camera."""
    random = np.random.default_rng(0)
    unit = random.normal(size=(800, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    albedo = random.uniform(0.1, 0.4, (800, 3))
    matrices, features, sightings, index = [], [], [], []
    for view in range(views):
        angle, height = 2 * np.pi * view / views, 0.3 + 3.5 * (view % 2)
        place = np.array([4 * np.cos(angle), 4 * np.sin(angle), height])
        matrix = pose.look_at(place, (0, 0, 0))
        seen = np.flatnonzero(unit @ place > 0.4 * np.linalg.norm(place))
        direction = {
            "world": np.array([0.6, 0.0, 0.8]),
            "camera": matrix[:3, :3] @ [0.6, -0.6, -0.53],
            "turntable": np.array([np.cos(angle + 0.8), np.sin(angle + 0.8), 0.5]),
        }[frame]
        light = 0.5 + lamp * np.maximum(unit[seen] @ direction, 0)
        colours = albedo[seen] * light[:, None] * np.exp(random.normal(0, noise, (len(seen), 1)))
        local = (unit[seen] - place) @ matrix[:3, :3]
        features.append(
            ViewFeatures(local / local[:, 2:], np.zeros((len(seen), 128), np.float32), colours.astype(np.float32), 1 / 250)
        )
        matrices.append(TURN @ matrix)
        sightings.append(np.stack([seen, np.full(len(seen), view)], axis=1))
        index.append(np.arange(len(seen)))
    where, which = np.concatenate(sightings), np.concatenate(index)
    cloud = Cloud(unit @ TURN[:3, :3].T, where, which, np.zeros(len(where)))
    named = tuple(View(str(k), CAMERA, matrix, "train", Path("none")) for k, matrix in enumerate(matrices))
    return Matches(named, tuple(features), ()), cloud, np.stack(matrices)


@pytest.mark.parametrize("frame", FRAMES)
def test_the_frame_of_the_lamps_explains_most(frame: str) -> None:
    found = light_frames(*ball(frame))
    assert found.points > 600 and found.sightings > 5000
    if frame == "world":
        assert max(found.explained.values()) < 0.05 and abs(found.margin) < 0.05  # nothing to explain but noise
        return
    assert found.best == frame and found.explained[frame] > 0.5
    assert found.margin > 0.4 and found.margin > 10 * found.std
    other = {"camera": "turntable", "turntable": "camera"}[frame]
    assert found.explained[frame] > found.explained[other]


def test_gains_of_views_are_no_light() -> None:
    matches, cloud, matrices = ball("world")
    for index, features in enumerate(matches.features):
        features.colours[:] *= 1.0 + 0.3 * (index % 3)
    assert light_frames(matches, cloud, matrices).margin < 0.05


def test_too_few_points_decide_nothing() -> None:
    matches, cloud, matrices = ball("camera")
    few = cloud.sightings[:, 0] < 40
    small = Cloud(cloud.points, cloud.sightings[few], cloud.features[few], cloud.errors_px[few])
    found = light_frames(matches, small, matrices)
    assert np.isnan(found.margin) and found.best == "world" and found.points <= 40


def test_the_axis_is_that_about_which_cameras_turn() -> None:
    _, _, matrices = ball("world")
    axis, frames = turntable(matrices)
    assert axis == pytest.approx(TURN[:3, 2], abs=1e-6)
    assert np.abs(np.linalg.det(frames) - 1).max() < 1e-12
    about = frames @ np.swapaxes(frames[:1], 1, 2)
    assert np.rad2deg(pose.rotation_angle(pose.rigid(about[1], np.zeros(3)))) == pytest.approx(15, abs=1e-3)  # 24 views
    assert turntable(matrices @ pose.from_rotation_vector((0, 0, np.pi / 2)))[0] == pytest.approx(axis, abs=1e-6)  # on its side


def test_normals_point_out_of_the_ball() -> None:
    _, cloud, matrices = ball("world")
    assert np.median((normals(cloud, matrices) * cloud.points).sum(1)) > 0.98  # 12 neighbours of 800 points
