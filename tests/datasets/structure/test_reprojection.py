"""Reprojection errors of a scene's points."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene, Sightings, View
from koala3d.datasets.structure.reprojection import errors_px
from koala3d.datasets.structure.triangulate import meeting_point


@pytest.fixture
def scene(camera_ring: Callable[..., list[View]]) -> Scene:
    """Twelve cameras that all see twenty points, without error."""
    views = camera_ring()
    points = np.random.default_rng(0).uniform([0.5, 1.5, 2.5], [1.5, 2.5, 3.5], (20, 3))
    index = np.array([(p, v) for v in range(12) for p in range(20)])
    pixels = np.concatenate(
        [v.camera.project((points - v.world_from_camera[:3, 3]) @ v.world_from_camera[:3, :3]) for v in views]
    )
    sightings = Sightings(tuple(v.name for v in views), index, pixels)
    return Scene("ring", tuple(views), 0.1, 9.0, np.array([[0.0, 0, 0], [1, 1, 1]]), "scene", points=points, sightings=sightings)


def test_exact_sightings_have_no_error(scene: Scene) -> None:
    assert errors_px(scene).max() < 1e-9


def test_errors_are_in_pixels_and_missing_views_have_none(scene: Scene) -> None:
    assert scene.sightings is not None
    moved = replace(scene.sightings, pixels=scene.sightings.pixels + np.array([3.0, 4.0]))
    errors = errors_px(replace(scene, sightings=moved, views=scene.views[1:]))
    assert np.isnan(errors[:20]).all()
    np.testing.assert_allclose(errors[20:], 5.0)


def test_points_behind_the_camera_are_infinitely_wrong(scene: Scene) -> None:
    assert scene.points is not None
    behind = scene.views[0].world_from_camera[:3, 3] - 2 * scene.views[0].world_from_camera[:3, 2]
    points = scene.points.copy()
    points[4] = behind
    assert np.isinf(errors_px(replace(scene, points=points))[4])


def test_a_scene_without_sightings_is_refused(scene: Scene) -> None:
    with pytest.raises(UsageError, match="which views saw its points"):
        errors_px(replace(scene, sightings=None))


def test_rays_of_views_meet_in_their_point(scene: Scene) -> None:
    assert scene.points is not None and scene.sightings is not None
    pixels = scene.sightings.pixels.reshape(12, 20, 2)
    found = meeting_point([(scene.views[k], pixels[k, 7]) for k in (0, 3, 5)])
    np.testing.assert_allclose(found, scene.points[7], atol=1e-9)
    assert meeting_point([(scene.views[0], pixels[0, 7]), (scene.views[0], pixels[0, 7])]) is None
