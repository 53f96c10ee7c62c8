"""A scene of three textured walls, rendered here, whose poses are known exactly and then spoilt."""

import cv2
import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.edit import refine
from koala3d.datasets.edit.refine import Prior
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View

CAMERA = Camera(200, 150, 187.5, 188.1, 100.6, 74.4, -0.05, 0.02)
WALLS = ((2, 0.0), (0, -0.25), (1, 0.25))
"""Axis and place of planes behind the middle of the scene."""


@pytest.fixture(scope="module")
def texture():
    rng = np.random.default_rng(0)
    coarse = sum(cv2.resize(rng.random((n, n)), (700, 700), interpolation=cv2.INTER_CUBIC) for n in (20, 60, 150))
    return (coarse - coarse.min()) / np.ptp(coarse)


def picture(world_from_camera, texture):
    rays = CAMERA.directions(CAMERA.pixel_centres()) @ world_from_camera[:3, :3].T
    centre = world_from_camera[:3, 3]
    best, grey = np.full(rays.shape[:2], np.inf), np.zeros(rays.shape[:2])
    for axis, place in WALLS:
        reach = (place - centre[axis]) / rays[..., axis]
        hit = np.delete(centre + reach[..., None] * rays, axis, -1)
        at = np.clip((hit + 0.7) / 1.4 * 699, 0, 698).astype(np.float32)
        value = cv2.remap(np.roll(texture, 200 * axis, 0).astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        nearer = (reach > 0) & (reach < best)
        best, grey = np.where(nearer, reach, best), np.where(nearer, value, grey)
    return np.repeat(np.rint(255 * grey).astype(np.uint8)[..., None], 3, -1)


@pytest.fixture(scope="module")
def walls(tmp_path_factory, texture):
    """(scene, true poses) of 8 views."""
    folder, views, truth = tmp_path_factory.mktemp("walls"), [], []
    for index in range(8):
        angle = -0.6 + 1.2 * index / 7
        matrix = pose.look_at((0.75 * np.cos(angle), -0.75 * np.sin(angle) - 0.1, 0.45 + 0.06 * (index % 3)), (0, 0.05, 0.12))
        images.write(folder / f"{index}.png", picture(matrix, texture))
        views.append(View(f"{index}", CAMERA, matrix, "train", folder / f"{index}.png"))
        truth.append(matrix)
    box = np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])
    return Scene("walls", tuple(views), 0.1, np.inf, box, "scene", metric=True), np.stack(truth)


def spoilt(scene, truth, millimetres, degrees, seed=0):
    rng = np.random.default_rng(seed)
    off = pose.from_rotation_vector(
        rng.normal(0, np.deg2rad(degrees), (len(truth), 3)), rng.normal(0, 1e-3 * millimetres, (len(truth), 3))
    )
    views = [View(v.name, v.camera, m, v.split, v.image) for v, m in zip(scene.views, truth @ off, strict=True)]
    return scene.with_views(tuple(views))


def errors(scene, truth):
    """(rms mm, rms deg)."""
    distance, angle = pose.difference(np.stack([v.world_from_camera for v in scene.views]), truth)
    return 1e3 * np.sqrt(np.mean(distance**2)), np.rad2deg(np.sqrt(np.mean(angle**2)))


def test_poses_that_explain_the_pictures_stay(walls):
    scene, _ = walls
    found = refine.refined(scene, Prior(1e-4, 1e-4))
    assert not found.used and found.scene is scene and "already" in found.reason
    assert found.before_px < 0.5 and found.points > 100


def test_poor_poses_become_better_and_the_points_set_aside_say_so(walls):
    scene, truth = walls
    poor = spoilt(scene, truth, 1.0, 0.3)
    found = refine.refined(poor, Prior(1e-3, 5e-3))
    assert found.used and found.after_px < 0.6 * found.before_px
    assert errors(found.scene, truth)[1] < 0.65 * errors(poor, truth)[1]  # eight orientations alone leave sqrt(1 / 8) of it
    shape = refine.aligned(np.stack([v.world_from_camera for v in found.scene.views]), truth, Prior(1e-3, 5e-3))
    turns = np.rad2deg(pose.difference(shape, truth)[1])
    assert np.median(turns) < 0.15  # the poses among each other; one at the rim may have kept the arm's
    assert 0.05 < found.moved_deg < 1.0


def test_alignment_undoes_a_motion_of_the_whole_scene(walls):
    _, truth = walls
    moved = pose.from_rotation_vector([0.2, -0.1, 0.3], [0.1, 0.2, -0.1]) @ truth
    np.testing.assert_allclose(refine.aligned(moved, truth, Prior(1e-3, 5e-3)), truth, atol=1e-9)


def test_reprojection_is_exact_for_perfect_tracks():
    rng = np.random.default_rng(3)
    poses = np.stack([pose.look_at((0.8 * np.cos(a), 0.8 * np.sin(a), 0.5), (0, 0, 0)) for a in (0, 0.3, 0.7, 1.0)])
    points = rng.uniform(-0.1, 0.1, (30, 3))
    pixels = [CAMERA.project(points @ pose.inverse(p)[:3, :3].T + pose.inverse(p)[:3, 3]) for p in poses]
    tracks = refine.Tracks(np.repeat(np.arange(30), 4), np.tile(np.arange(4), 30), np.stack(pixels, 1).reshape(-1, 2))
    everything = np.ones(120, bool)
    assert refine.reprojection(tracks, everything, poses, CAMERA).max() < 1e-6
    turned = poses.copy()
    turned[2] = turned[2] @ pose.from_rotation_vector([0, 0.01, 0])
    assert np.median(refine.reprojection(tracks, everything, turned, CAMERA)) > 0.5


def test_pictures_without_texture_are_refused(walls, tmp_path):
    scene, _ = walls
    for index in range(4):
        images.write(tmp_path / f"{index}.png", np.full((150, 200, 3), 128, np.uint8))
    blank = scene.with_views(
        tuple(View(f"{i}", CAMERA, scene.views[i].world_from_camera, "train", tmp_path / f"{i}.png") for i in range(4))
    )
    with pytest.raises(DatasetError, match="too few points"):
        refine.refined(blank, Prior(1e-3, 5e-3))


def test_several_cameras_are_refused(walls):
    scene, _ = walls
    other = View("x", CAMERA.scaled(100, 75), scene.views[0].world_from_camera, "train", scene.views[0].image)
    with pytest.raises(DatasetError, match="different cameras"):
        refine.refined(scene.with_views((*scene.views, other)), Prior(1e-3, 5e-3))
