"""Scenes on disk: readable by every command, true to their shape, the same every time."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets.checks.check import check
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.output import metrics
from koala3d.reconstruct.output.mesh.nearest import Nearest
from koala3d.reconstruct.rendered import make, shiny
from koala3d.reconstruct.rendered.make import provide, write, write_mesh
from koala3d.reconstruct.rendered.stages import spiral_poses
from koala3d.reconstruct.rendered.views import Traced, camera_of


@pytest.fixture(scope="module")
def ball_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The chrome ball, small."""
    folder = tmp_path_factory.mktemp("bench") / "chrome_ball"
    write("chrome_ball", folder, size=40, train=4, test=2)
    return folder


@pytest.fixture(scope="module")
def ball(ball_folder: Path) -> Scene:
    """It, read again."""
    return load_scene(ball_folder)


def test_the_truth_of_a_ball_is_a_ball(ball: Scene) -> None:
    radius = 0.8 * shiny.RADIUS_M
    for view in ball.split("test"):
        alpha, depth, normals = (view.read_truth(name) for name in ("alpha", "depth", "normals"))
        whole = alpha[..., 0] > 0.99
        assert 0.2 < whole.mean() < 0.8
        rays = view.camera.directions(view.camera.pixel_centres()) @ view.world_from_camera[:3, :3].T
        points = view.world_from_camera[:3, 3] + depth * rays
        # a pixel is 6 mm wide: within it the depth varies, and its mean is not that of its middle
        np.testing.assert_allclose(np.linalg.norm(points[whole], axis=-1), radius, atol=1e-3)
        outward = points / np.linalg.norm(points, axis=-1, keepdims=True)
        assert np.median(metrics.angles_deg(normals, outward)[whole]) < 0.1  # a pixel spans three degrees; its mean is its middle


def test_pictures_are_the_sum_of_their_parts(ball: Scene) -> None:
    view = ball.split("test")[0]
    light = view.read_truth("diffuse") + view.read_truth("specular")
    picture, alpha = view.read(), view.read_truth("alpha")
    whole = alpha[..., 0] > 0.99
    expected = np.clip(images.srgb_from_linear(light), 0, 1)
    np.testing.assert_allclose(picture[whole][:, :3], expected[whole], atol=0.004)  # 8 bits, and alpha of almost one
    np.testing.assert_allclose(picture[..., 3:], alpha, atol=0.0021)


def test_scenes_pass_the_check(ball: Scene, ball_folder: Path) -> None:
    assert not [finding.line for finding in check(ball_folder, matches=False) if finding.level == "error"]
    assert ball.metric and len(ball.split("train")) == 4 and len(ball.split("test")) == 2
    high = ball.box[1]
    np.testing.assert_allclose(high, 0.8 * shiny.RADIUS_M * (1 + 2 * make.MARGIN), rtol=0.02)
    assert ball.near < ball.far < 1


def test_the_mesh_is_the_surface(ball_folder: Path) -> None:
    mesh = trimesh.load_mesh(ball_folder / "truth" / "object.ply", process=False)
    assert mesh.is_watertight and mesh.volume > 0  # triangles face outwards
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=-1), 0.8 * shiny.RADIUS_M, atol=1e-6)


@pytest.mark.parametrize("name", ["three_metals"])
def test_meshes_are_where_the_pictures_show_them(name: str, tmp_path: Path) -> None:
    tracer = shiny.SCENES[name]()
    box = write_mesh(tracer, tmp_path / "object.ply", cells=48)
    assert (np.abs(box) < shiny.RADIUS_M).all()
    mesh = trimesh.load_mesh(tmp_path / "object.ply")
    camera = camera_of(32)
    maps = Traced(tracer).maps(camera, matrix := spiral_poses(5, 0)[2])
    whole = maps["alpha"][..., 0] > 0.99
    points = matrix[:3, 3] + maps["depth"] * (camera.directions(camera.pixel_centres()) @ matrix[:3, :3].T)
    assert (
        np.median(Nearest(mesh, count=20_000).feet(points[whole]).distance) < 3e-4
    )  # a pixel is 7 mm wide here, and the ball's bulge in it 0.3 mm


def test_the_same_scene_again_is_the_same() -> None:
    camera, matrix = camera_of(16), spiral_poses(4, 0)[1]
    first, second = (Traced(shiny.SCENES["chrome_ball"]()).maps(camera, matrix) for _ in range(2))
    assert all((first[channel] == values).all() for channel, values in second.items())
    assert 0.1 < first["alpha"].mean() < 0.8 and first["specular"].max() > 0.15


def test_materials_range_from_all_mirror_to_mostly_matte() -> None:
    shares = [np.mean(body.material.mirror) / (np.mean(body.material.mirror) + np.mean(body.material.matte))
              for made in shiny.SCENES.values() for body in made().bodies]  # fmt: skip
    assert max(shares) == 1 and min(shares) < 0.1


def test_what_is_there_is_kept(ball_folder: Path, tmp_path: Path) -> None:
    before = (ball_folder / "cameras.json").stat().st_mtime_ns
    assert not provide("chrome_ball", ball_folder, size=40, train=4, test=2)
    assert (ball_folder / "cameras.json").stat().st_mtime_ns == before
    with pytest.raises(UsageError, match="exists"):
        provide("chrome_ball", ball_folder, size=48, train=4, test=2)
    with pytest.raises(UsageError, match="did you mean 'teapot'"):
        write("tepot", tmp_path / "tepot")
