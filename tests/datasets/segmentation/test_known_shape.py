"""Masks of a mesh, beside the exact outline of a ball, and the command that writes them."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from typer.testing import CliRunner

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.cli import app
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import koala, load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.segmentation.known_shape import silhouettes

CAMERA = Camera(96, 72, 100.0, 101.0, 47.0, 37.0, k1=-0.4, k2=0.05, p1=0.002)
CENTRE = np.array([1.0, 2.0, 3.0])
RADIUS = 0.7


def ball() -> trimesh.Trimesh:
    shape = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    return shape.apply_translation(CENTRE)


def coverage(view: View, centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """(height, width) share of each pixel that the ball about `centre` covers, by 4 x 4 rays."""
    fine = view.camera.scaled(4 * view.camera.width, 4 * view.camera.height)
    origin = view.world_from_camera[:3, 3] - centre
    rays = fine.directions(fine.pixel_centres()) @ view.world_from_camera[:3, :3].T
    b, a, c = rays @ origin, (rays**2).sum(-1), origin @ origin - RADIUS**2
    inside = (b * b > a * c) & (b < 0)
    return inside.reshape(view.camera.height, 4, view.camera.width, 4).mean((1, 3))


@pytest.fixture
def views(camera_ring: Callable[..., list[View]]) -> list[View]:
    return [replace(view, camera=CAMERA) for view in camera_ring(count=5)]


def test_a_balls_mask_is_its_outline_through_the_lens(views: list[View]) -> None:
    for view, mask in zip(views, silhouettes(views, ball().vertices, ball().faces), strict=True):
        exact = coverage(view, CENTRE)
        assert 0.1 < exact.mean() < 0.5
        wrong = mask != (exact >= 0.5)
        assert wrong[(exact < 0.3) | (exact > 0.7)].sum() == 0
        outline = np.sqrt(4 * np.pi * exact.sum())  # of a disc as large [px]
        assert abs(mask.sum() - exact.sum()) < 0.08 * outline, "OpenCV alone draws outlines a sixth of a pixel too far out"
    straight = replace(views[0], camera=CAMERA.undistorted())
    moved = (coverage(straight, CENTRE) >= 0.5) != (coverage(views[0], CENTRE) >= 0.5)
    assert moved.sum() >= 5  # the premise: the lens matters


def test_what_is_behind_the_camera_is_not_seen(views: list[View]) -> None:
    behind = [replace(view, world_from_camera=view.world_from_camera @ np.diag([1.0, -1, -1, 1])) for view in views]
    assert not any(mask.any() for mask in silhouettes(behind, ball().vertices, ball().faces))


@pytest.fixture
def scene(views: list[View], tmp_path: Path) -> Path:
    path = tmp_path / "grey.png"
    images.write(path, np.full((CAMERA.height, CAMERA.width, 3), 128, np.uint8))
    pictured = tuple(replace(view, image=path) for view in views)
    box = np.stack([CENTRE - 1.2, CENTRE + 1.2])
    koala.save(Scene("grey", pictured, 0.5, 10.0, box, "scene", bounds_from="box stated; near from 9 points"), tmp_path / "scene")
    (tmp_path / "scene" / "truth").mkdir()
    ball().export(tmp_path / "scene" / "truth" / "object.ply")
    return tmp_path / "scene"


def test_the_command_masks_a_scene_whose_colours_tell_nothing(scene: Path, tmp_path: Path) -> None:
    mesh = scene / "truth" / "object.ply"
    arguments = ["mask", str(scene), "--mesh", str(mesh), "--out", str(tmp_path / "masked"), "--json"]
    ran = CliRunner().invoke(app, arguments)
    assert ran.exit_code == 0, ran.output
    assert json.loads(ran.stdout) == {"out": str(tmp_path / "masked"), "views": 5, "unseen": 0}
    assert (tmp_path / "masked" / "truth" / "object.ply").read_bytes() == mesh.read_bytes()  # for 'reconstruct eval'
    masked = load_scene(str(tmp_path / "masked"))
    assert masked.background == "white" and masked.box_is_stated and masked.provenance["masks_from"] == "mesh"
    np.testing.assert_allclose(masked.box, load_scene(str(scene)).box)
    for view in masked.views:
        exact = coverage(view, CENTRE)
        sure = (exact < 0.2) | (exact > 0.8)
        np.testing.assert_array_equal(view.read_mask()[..., 0][sure] > 0.5, exact[sure] >= 0.5)


def test_a_mesh_elsewhere_and_options_that_do_not_go_with_it_are_refused(scene: Path, tmp_path: Path) -> None:
    ball().apply_scale(1000).export(tmp_path / "millimetres.ply")
    arguments = ["mask", str(scene), "--mesh", str(tmp_path / "millimetres.ply"), "--out", str(tmp_path / "masked")]
    for more, words in ([], "not where the views look (5 of 5 views do not see it)"), (["--page"], "needs no --ball"):
        ran = CliRunner().invoke(app, [*arguments, *more])
        assert isinstance(ran.exception, UsageError) and words in str(ran.exception)
    assert not (tmp_path / "masked").exists()
