"""Errors of a calibration, propagated to a small object in the middle of cameras all around."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct.output.shape import common

CAMERA, DISTANCE = Camera(800, 600, 900.0, 900.0, 400.0, 300.0), 0.5
MOUNT = pose.look_at((0.05, -0.02, 0.1), (0.0, 0.0, 0.6))
RNG = np.random.default_rng(0)
POINTS = 0.02 * RNG.normal(size=(400, 3)) + [0.4, 0.1, 0.2]


def scene(covariance: np.ndarray) -> Scene:
    """Forty cameras in all directions; rolled at random, as an arm holds them."""
    directions = RNG.normal(size=(40, 3))
    views = []
    for index, direction in enumerate(directions / np.linalg.norm(directions, axis=-1, keepdims=True)):
        matrix = pose.look_at(POINTS.mean(0) + DISTANCE * direction, POINTS.mean(0)) @ pose.from_rotation_vector((0, 0, index))
        views.append(View(f"{index:02}", CAMERA, matrix, "train", Path()))
    box = np.stack([POINTS.min(0), POINTS.max(0)])
    stated = {"flange_from_camera": UncertainPose(MOUNT, covariance).to_json()}
    return Scene("rig", tuple(views), 0.1, np.inf, box, "white", metric=True, provenance=stated)


def along(direction: np.ndarray, std: float) -> np.ndarray:
    """Covariance of a shift of the camera along a direction of its own."""
    covariance = np.zeros((6, 6))
    axis = MOUNT[:3, :3] @ direction
    covariance[:3, :3] = std**2 * np.outer(axis, axis)
    return covariance


def test_a_camera_that_is_further_back_makes_the_object_larger() -> None:
    """By the shift over the distance, and it stays where it is."""
    found = common.of(scene(along(np.array([0.0, 0.0, 1.0]), 1e-3)), POINTS)
    assert found is not None
    assert found.scale_std == pytest.approx(1e-3 / DISTANCE, rel=0.02)
    assert found.place_std < 1e-4


def test_a_camera_that_is_shifted_across_moves_rays_that_do_not_agree() -> None:
    """Cameras rolled at random each move it elsewhere: little is left in common."""
    found = common.of(scene(along(np.array([1.0, 0.0, 0.0]), 1e-3)), POINTS)
    assert found is not None and found.scale_std < 2e-4 and found.place_std < 5e-4


def test_points_move_with_the_size() -> None:
    found = common.of(scene(along(np.array([0.0, 0.0, 1.0]), 1e-3)), POINTS)
    assert found is not None
    outward = np.eye(3)
    at = found.centre + 0.05 * outward
    np.testing.assert_allclose(found.along(at, outward), 0.05 * found.scale_std, rtol=0.2)
    across = np.roll(outward, 1, axis=1)
    assert (found.along(at, across) < 0.3 * found.along(at, outward)).all()


def test_a_focal_length_counts_if_the_calibration_is_still_there(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    Calibration(CAMERA, {"fx": 1.8, "fy": 1.8}, flange_from_camera=UncertainPose(MOUNT, np.zeros((6, 6)))).save(path)
    given = scene(np.zeros((6, 6)))
    stated = given.provenance | {"calibration": str(path), "calibration_sha256": files.sha256(path)}
    found = common.of(replace(given, provenance=stated), POINTS)
    assert found is not None
    assert found.scale_std == pytest.approx(1.8 / 900 / np.sqrt(2), rel=0.1), "half of it by each of fx and fy, independent"
    other = common.of(replace(given, provenance=stated | {"calibration_sha256": "of another"}), POINTS)
    assert other is not None and other.scale_std < 1e-9


def test_a_scene_that_states_nothing_has_none() -> None:
    assert common.of(replace(scene(np.eye(6)), provenance={}), POINTS) is None
