"""One scene and one model, written in every format: a known point is at one place, in metres, in the base of the arm.

The object is the ball with a nose, so that neither a turn nor a mirror image goes unnoticed. Its tip is the point. Files are read
by other libraries, or by what their format says, written out here; none by Koala's readers.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
import yaml

from koala3d.datasets import pose
from koala3d.datasets.formats import WRITERS, koala, save_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.asset import asset as assets
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.writing import saving
from koala3d.reconstruct.field.appearance import Material
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.output import camera_path, export
from koala3d.reconstruct.output.mesh import extraction, files
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.scene.space import BOX
from tests.reconstruct.conftest import CENTRE, RADIUS, Ball

TOWARDS = np.array([0.6, -0.64, 0.48])  # of unit length
NOSE = 0.015  # its radius [m]
TIP = CENTRE + (RADIUS + NOSE) * TOWARDS
NEAR_M = 3e-3  # a cell of the grid of 65 points that the surface is taken from
PIXEL = 1e-6  # poses are written with all their digits


class Nosed(Ball):
    """The ball with a smaller ball on its surface."""

    def places(self, points: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(n,) signed distances from the surface, and (3, n) from the centre of whichever ball is nearer."""
        from_nose = points - self.radius * jnp.asarray(TOWARDS, jnp.float32)[:, None]
        ball = jnp.linalg.norm(points, axis=0) - self.radius
        nose = jnp.linalg.norm(from_nose, axis=0) - self.radius * NOSE / RADIUS
        return jnp.minimum(ball, nose), jnp.where(nose < ball, from_nose, points)

    def density(self, cloud: Cloud) -> jax.Array:
        return 2000 * jax.nn.sigmoid(-self.places(cloud.points)[0] / 0.002)

    def __call__(self, cloud: Cloud) -> tuple[jax.Array, Material]:
        _, outward = self.places(cloud.points)
        return self.density(cloud), super().__call__(replace(cloud, points=outward))[1]


@pytest.fixture
def nosed(ball: TrainedModel) -> TrainedModel:
    """In place of a trained model."""
    field, grid = ball.model.field, ball.run.config.sampler.grid
    solid = Nosed(**vars(field))
    axis = (np.arange(grid) + 0.5) / grid * 2 - 1
    centres = np.stack(np.meshgrid(axis, axis, axis, indexing="ij")).reshape(3, -1)
    possible = np.abs(np.asarray(solid.places(jnp.asarray(centres, jnp.float32))[0])) < 3 / grid
    occupancy = Occupancy.create(0, grid=grid, outer_grid=8, space=BOX, steps=32, possible=possible)
    return replace(ball, model=replace(ball.model, field=solid, sampler=replace(ball.model.sampler, grid=occupancy)))


def tip_of(vertices: np.ndarray) -> np.ndarray:
    """The vertex furthest from the ball's centre."""
    return vertices[np.argmax(np.linalg.norm(vertices - CENTRE, axis=-1))]


@pytest.mark.parametrize("suffix", files.SUFFIXES)
def test_meshes_and_points_are_in_the_base(nosed: TrainedModel, tmp_path: Path, suffix: str) -> None:
    surface = extraction.extract(nosed, resolution=65)
    files.save(surface, tmp_path / f"mesh{suffix}")
    read = (
        trimesh.load(tmp_path / f"mesh{suffix}").to_geometry() if suffix == ".glb" else trimesh.load(tmp_path / f"mesh{suffix}")
    )
    assert np.abs(tip_of(read.vertices) - TIP).max() < NEAR_M
    if suffix == ".ply":
        files.save(files.points_on(surface, 20_000), tmp_path / "points.ply")
        assert np.abs(tip_of(trimesh.load(tmp_path / "points.ply").vertices) - TIP).max() < NEAR_M


_made: list[Asset] = []


@pytest.fixture
def asset(nosed: TrainedModel) -> Asset:
    """The asset, made once."""
    pytest.importorskip("xatlas", reason="xatlas is absent: pip install 'koala-capture[asset]'")
    if not _made:
        _made.append(assets.make(nosed, faces=4000, size=64, resolution=65)[0])
    return _made[0]


def of_glb(path: Path) -> tuple[np.ndarray, np.ndarray]:
    scene = trimesh.load(path)
    length = int.from_bytes(path.read_bytes()[12:16], "little")
    extras = json.loads(path.read_bytes()[20 : 20 + length])["asset"]["extras"]
    assert extras["unit"] == "m"
    return scene.to_geometry().vertices, np.array(extras["base_from_asset"])


def of_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    frame = json.loads(path.with_name(f"{path.stem}_frame.json").read_text())
    assert frame["metric"]
    return trimesh.load(path).vertices, np.array(frame["base_from_asset"])


def of_usd(path: Path) -> tuple[np.ndarray, np.ndarray]:
    pxr = pytest.importorskip("pxr", reason="usd-core is absent: pip install 'koala-capture[asset]'")
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(path))
    assert pxr and UsdGeom.GetStageMetersPerUnit(stage) == 1
    points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/asset/mesh")).GetPointsAttr().Get(), np.float64)
    about = stage.GetDefaultPrim().GetCustomData()
    assert about["unit"] == "m"
    return points, np.array(json.loads(about["base_from_asset"]))


@pytest.mark.parametrize(("suffix", "read"), [(".glb", of_glb), (".obj", of_obj), (".usd", of_usd), (".usdz", of_usd)])
def test_assets_say_how_to_get_to_the_base(
    asset: Asset, tmp_path: Path, suffix: str, read: Callable[[Path], tuple[np.ndarray, np.ndarray]]
) -> None:
    saving.writer(tmp_path / f"asset{suffix}")(asset, tmp_path / f"asset{suffix}")
    vertices, base_from_asset = read(tmp_path / f"asset{suffix}")
    assert np.linalg.norm(tip_of(vertices) - TIP) > 0.1  # it does stand in another frame
    in_base = vertices @ base_from_asset[:3, :3].T + base_from_asset[:3, 3]
    assert np.abs(tip_of(in_base) - TIP).max() < NEAR_M


def test_pictures_along_a_path_are_taken_from_the_base(nosed: TrainedModel, tmp_path: Path) -> None:
    """The depth of the middle of a picture leads from the path's own position to the tip."""
    place = CENTRE + 0.3 * TOWARDS
    stops = [{"position": place.tolist(), "target": CENTRE.tolist()}, {"position": [0.6, 0.1, 0.4], "target": CENTRE.tolist()}]
    (tmp_path / "path.yaml").write_text(yaml.safe_dump({"fps": 1, "seconds": 2, "poses": stops}))
    frames, _ = camera_path.from_file(tmp_path / "path.yaml")
    export.render_along(nosed, frames[:1], tmp_path / "film")
    depth = images.read(tmp_path / "film" / "depth" / "0000.exr")
    middle = depth[depth.shape[0] // 2, depth.shape[1] // 2].item()
    assert np.abs(place - middle * TOWARDS - TIP).max() < NEAR_M


def flipped(matrix: object) -> np.ndarray:
    """A camera's pose with y up and z back, with y down and z forward."""
    return np.asarray(matrix, np.float64) @ np.diag([1.0, -1, -1, 1])


def projection(matrix: np.ndarray, world_from_camera: np.ndarray) -> np.ndarray:
    """(3, 4) from the world to pixels."""
    return matrix @ pose.inverse(world_from_camera)[:3]


def intrinsics(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def of_koala(folder: Path, scene: Scene) -> dict[str, np.ndarray]:
    content = json.loads((folder / koala.FILE).read_text())
    found = {}
    for one in content["views"]:
        matrix = intrinsics(*(one["camera"][key] for key in ("fx", "fy", "cx", "cy")))
        found[one["name"]] = projection(matrix, np.array(one["world_from_camera"]))
    return found


def of_blender(folder: Path, scene: Scene) -> dict[str, np.ndarray]:
    found = {}
    for path in folder.glob("transforms_*.json"):
        content = json.loads(path.read_text())
        focal = 0.5 * content["w"] / np.tan(content["camera_angle_x"] / 2)
        for frame in content["frames"]:
            matrix = intrinsics(focal, focal, content["w"] / 2, content["h"] / 2)
            found[Path(frame["file_path"]).name] = projection(matrix, flipped(frame["transform_matrix"]))
    return found


def of_nerfstudio(folder: Path, scene: Scene) -> dict[str, np.ndarray]:
    content = json.loads((folder / "transforms.json").read_text())
    original_from_saved = np.linalg.inv(np.vstack([content["applied_transform"], [0, 0, 0, 1]]))
    assert content.get("applied_scale", 1) == 1
    return {
        Path(one["file_path"]).stem: projection(
            intrinsics(*((one | content)[key] for key in ("fl_x", "fl_y", "cx", "cy"))),
            original_from_saved @ flipped(one["transform_matrix"]),
        )
        for one in content["frames"]
    }


def of_llff(folder: Path, scene: Scene) -> dict[str, np.ndarray]:
    rows = np.load(folder / "poses_bounds.npy")[:, :15].reshape(-1, 3, 5)
    found = {}
    for row, path in zip(rows, sorted((folder / "images").iterdir()), strict=True):
        down, right, back, place = row[:, :4].T
        height, width, focal = row[:, 4]
        matrix = pose.rigid(np.stack([right, down, -back], -1), place)
        found[path.stem] = projection(intrinsics(focal, focal, width / 2, height / 2), matrix)
    return found


def of_dtu(folder: Path, scene: Scene) -> dict[str, np.ndarray]:
    stored, found = np.load(folder / "cameras_sphere.npz"), {}
    for number, view in enumerate(scene.views):
        shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # its first pixel's centre is (0, 0)
        found[view.name] = shift @ stored[f"world_mat_{number}"][:3]
    return found


def of_colmap(folder: Path, scene: Scene) -> dict[str, np.ndarray]:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this machine")
    model, found = pycolmap.Reconstruction(str(folder / "sparse" / "0")), {}
    for image in model.images.values():
        rigid = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        camera_from_world = np.vstack([rigid.matrix(), [0, 0, 0, 1]])
        found[Path(image.name).stem] = model.cameras[image.camera_id].calibration_matrix() @ camera_from_world[:3]
    return found


READERS = {
    "koala": of_koala,
    "blender": of_blender,
    "nerfstudio": of_nerfstudio,
    "llff": of_llff,
    "dtu": of_dtu,
    "colmap": of_colmap,
    "colmap-text": of_colmap,
    "mipnerf360": of_colmap,
}


def test_every_layout_has_a_reader_here() -> None:
    assert set(READERS) == set(WRITERS)


@pytest.mark.parametrize("layout", READERS)
def test_scenes_are_in_the_base(ball_scene: tuple[Scene, Path], tmp_path: Path, layout: str) -> None:
    """Every view of the file sees the tip, and a point behind it, at the pixels at which the scene's own view does."""
    scene, _ = ball_scene
    save_scene(scene, tmp_path / layout, layout)
    found = READERS[layout](tmp_path / layout, scene)
    assert set(found) == {view.name for view in scene.views} and len(found) == 6
    for view in scene.views:
        for point in (TIP, TIP - 0.3 * TOWARDS):
            seen = found[view.name] @ [*point, 1]
            expected = view.camera.project((pose.inverse(view.world_from_camera) @ [*point, 1])[:3])
            assert np.abs(seen[:2] / seen[2] - expected).max() < PIXEL
    beside = tmp_path / layout / ("cameras.json" if layout == "koala" else "koala.json")
    assert json.loads(beside.read_text())["metric"] is True
