"""Bounds measured in pictures of which the geometry is known."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.formats import koala, load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure import bounds, matching, measure
from koala3d.datasets.structure.measure import measured
from koala3d.datasets.structure.triangulate import agreement, triangulate


def test_points_lie_on_the_walls_and_bounds_about_them(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    found = measured(scene)
    assert found.points is not None and len(found.points) > 200
    depth = found.points[:, 2]
    square = (np.abs(found.points[:, :2]) < 0.8).all(1) & (np.abs(depth) < 0.5)
    off = np.where(square, np.abs(depth), np.abs(depth - 2))
    assert np.median(off) < 0.01 and np.quantile(off, 0.98) < 0.13  # half a pixel (0.014 at 6) over tracks of 6 degrees
    assert square.sum() > 50 and (~square).sum() > 50
    assert found.box[0, 2] == pytest.approx(-0.1, abs=0.06) and found.box[1, 2] == pytest.approx(2.1, abs=0.1)
    assert 0.8 * 3.3 < found.near < 4.0 and 2 * 5.5 < found.far < 2 * 7.5  # the square stands 4 away, its corners nearer
    assert "points triangulated from 12 views" in found.bounds_from and "%" not in found.bounds_from, (
        "what is right is not doubted"
    )


def test_poses_that_explain_little_are_doubted(two_walls: Callable[..., Scene], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "agreement", lambda matches, matrices: 0.12)
    assert "the poses explain only 12% of the matches, see 'datasets check'" in measured(two_walls()).bounds_from


def test_wrong_poses_give_no_points_and_keep_the_bounds(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    flipped = scene.with_views(
        tuple(replace(v, world_from_camera=v.world_from_camera @ np.diag([1.0, -1, -1, 1])) for v in scene.views)
    )
    found = measured(flipped)
    assert np.array_equal(found.box, scene.box) and found.near == scene.near
    assert "too few" in found.bounds_from


def test_agreement_tells_right_poses_from_wrong_ones(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    matrices = np.stack([v.world_from_camera for v in scene.views])
    matches = matching.matched(scene.views, matching.neighbours(matrices, np.zeros(3)))
    assert matches.count > 1000 and agreement(matches, matrices) > 0.85
    assert agreement(matches, matrices @ np.diag([1.0, -1, -1, 1])) < 0.3
    assert agreement(matches, pose.inverse(matrices)) < 0.3
    cloud = triangulate(matches, matrices)
    assert np.median(cloud.errors_px) < 0.5 and (np.bincount(cloud.sightings[:, 0]) >= 3).all()
    local = np.einsum(
        "nij,ni->nj",
        matrices[cloud.sightings[:, 1], :3, :3],
        cloud.points[cloud.sightings[:, 0]] - matrices[cloud.sightings[:, 1], :3, 3],
    )
    assert (local[:, 2] > 0).all()


def test_pictures_without_texture_have_no_matches(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    for view in scene.views:
        images.write(view.image, np.full((150, 200, 3), 0.5))
    found = measured(scene)
    assert found.points is None and "only 0 points" in found.bounds_from


def test_noisy_images_are_searched_at_smaller_sizes(two_walls: Callable[..., Scene], monkeypatch: pytest.MonkeyPatch) -> None:
    scene = two_walls(Camera(400, 300, 440.0, 442.0, 202.0, 148.0))
    random = np.random.default_rng(0)
    for view in scene.views:
        picture = images.read(view.image)
        images.write(view.image, np.clip(0.3 + 0.4 * picture + random.normal(scale=0.16, size=picture.shape), 0, 1))
    # Between the 35 points of the pictures as they are and the 43 of half their size.
    monkeypatch.setattr(bounds, "FEWEST_POINTS", 39)
    found = measured(scene)
    assert 0.8 * 3.3 < found.near < 4.0, found.bounds_from
    monkeypatch.setattr(measure, "SHRINK", (1,))
    assert "too few" in measured(scene).bounds_from


def test_measuring_is_on_request_and_never_replaces_stated_bounds(two_walls: Callable[..., Scene], tmp_path: Path) -> None:
    scene = two_walls()
    koala.save(scene, tmp_path / "unknown")
    assert load_scene(tmp_path / "unknown").points is None
    assert load_scene(tmp_path / "unknown", measure=True).points is not None
    koala.save(replace(scene, bounds_from="stated"), tmp_path / "stated")
    kept = load_scene(tmp_path / "stated", measure=True)
    assert kept.bounds_from == "stated" and np.array_equal(kept.box, scene.box)
