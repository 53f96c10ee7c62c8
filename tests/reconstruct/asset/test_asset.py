"""The ball, whose field is known, as an asset: frame, size, values of textures, and files that others read."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets.imaging import images
from koala3d.reconstruct.asset import asset as assets
from koala3d.reconstruct.asset.materials import metallic_roughness
from koala3d.reconstruct.asset.writing import glb, obj, usd
from koala3d.reconstruct.output.trained_model import TrainedModel

CENTRE, RADIUS = np.array([0.4, 0.0, 0.15]), 0.08
MODULES = Path(__file__).parents[3] / "build" / "tools" / "node_modules"
VALIDATE = (
    "const v = require('gltf-validator'), fs = require('fs');"
    "v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then(r => console.log(JSON.stringify(r.issues)))"
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, assets.Asset]:
    """The asset, made once."""
    return {}


@pytest.fixture
def asset(ball: TrainedModel, made: dict[str, assets.Asset]) -> assets.Asset:
    pytest.importorskip("xatlas", reason="xatlas is absent: pip install 'koala-capture[asset]'")
    if "ball" not in made:
        made["ball"] = assets.make(ball, faces=1500, size=128, resolution=48)[0]
    return made["ball"]


def test_the_file_is_read_back_in_the_right_frame_and_size(asset: assets.Asset, tmp_path: Path) -> None:
    glb.save(asset, tmp_path / "ball.glb")
    scene = trimesh.load(tmp_path / "ball.glb")
    read = scene.to_geometry()
    low, high = read.bounds  # a grid cell is 4 mm wide; the mesh is right to a fifth of that
    np.testing.assert_allclose(high - low, 2 * RADIUS, atol=2e-3)
    assert low[1] == pytest.approx(0, abs=1e-6)  # stands at the origin, y up
    world = read.vertices @ asset.base_from_asset[:3, :3].T + asset.base_from_asset[:3, 3]
    np.testing.assert_allclose((world.min(0) + world.max(0)) / 2, CENTRE, atol=2e-3)
    np.testing.assert_allclose(asset.base_from_asset[:3, 1], [0, 0, 1])


def test_a_field_of_one_colour_gives_textures_of_one_colour(asset: assets.Asset) -> None:
    """Diffuse 0.1 0.2 0.3 under even light: albedos in that proportion, wherever they were lit alike."""
    base = images.linear_from_srgb(asset.textures.base_colour.reshape(-1, 3) / 255)
    middle = np.median(base, axis=0)
    assert np.all(middle > 0) and np.all(np.isfinite(base))
    assert np.mean(np.abs(base - middle).max(-1) < 0.25 * middle.max()) > 0.9  # depth maps leave the rims a little dark
    normal = asset.textures.normal.reshape(-1, 3) / 127.5 - 1
    assert np.median(normal[:, 2]) > 0.97  # the ball's normals are the mesh's, within 14 degrees of facets


def test_metallic_roughness_gives_back_albedo_and_reflectance() -> None:
    """Grey materials fit exactly: one equation for each of two numbers."""
    albedo, reflectance = (np.repeat(np.array(values)[:, None], 3, 1) for values in ([0.5, 0.0, 0.2], [0.04, 0.8, 0.3]))
    base, metallic, factor = metallic_roughness(albedo, reflectance)
    rest = (1 - metallic)[:, None]
    np.testing.assert_allclose(base * rest, albedo, atol=1e-6)
    np.testing.assert_allclose(0.04 * rest * factor + base * metallic[:, None], reflectance, atol=1e-6)


def test_a_mesh_of_the_field_stays_closed_in_the_file(asset: assets.Asset, tmp_path: Path) -> None:
    """Vertices are repeated along seams of the texture; merged by place, as printing programs do, they leave no edge open."""
    glb.save(asset, tmp_path / "ball.glb")
    read = trimesh.load(tmp_path / "ball.glb").to_geometry()
    merged = trimesh.Trimesh(read.vertices, read.faces)
    assert len(merged.vertices) < len(read.vertices) and merged.is_watertight and merged.volume > 0


def test_khronos_validator_finds_no_error(asset: assets.Asset, tmp_path: Path) -> None:
    glb.save(asset, tmp_path / "ball.glb")
    if shutil.which("node") is None or not (MODULES / "gltf-validator").is_dir():
        pytest.skip("Node or Khronos' validator is absent: make tools")
    done = subprocess.run(
        ["node", "-e", VALIDATE, tmp_path / "ball.glb"],
        env={**os.environ, "NODE_PATH": str(MODULES)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    found = json.loads(done.stdout)
    assert found["numErrors"] == 0 and found["numWarnings"] == 0, found


def test_obj_and_usd_are_read_back(asset: assets.Asset, tmp_path: Path) -> None:
    obj.save(asset, tmp_path / "ball.obj")
    assert len(trimesh.load(tmp_path / "ball.obj").faces) == len(asset.mesh.faces)
    pxr = pytest.importorskip("pxr", reason="usd-core is absent: pip install 'koala-capture[asset]'")
    assert pxr
    from pxr import Usd, UsdGeom

    usd.save_packed(asset, tmp_path / "ball.usdz")
    stage = Usd.Stage.Open(str(tmp_path / "ball.usdz"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/asset/mesh"))
    np.testing.assert_allclose(np.ptp(np.array(mesh.GetPointsAttr().Get()), axis=0), 2 * RADIUS, atol=2e-3)


def test_the_validators_of_usd_find_nothing(asset: assets.Asset, tmp_path: Path) -> None:
    pytest.importorskip("pxr", reason="usd-core is absent: pip install 'koala-capture[asset]'")
    validation = pytest.importorskip("pxr.UsdValidation", reason="this usd-core has no validators: pip install 'usd-core>=25.8'")
    from pxr import Usd, UsdGeom

    context = validation.ValidationContext(validation.ValidationRegistry().GetOrLoadAllValidators())
    found = lambda stage: {error.GetName(): error.GetMessage() for error in context.Validate(stage)}  # noqa: E731
    empty = Usd.Stage.CreateInMemory()
    UsdGeom.Mesh.Define(empty, "/mesh")
    assert "MissingDefaultPrim" in found(empty)  # they do look
    for save, name in ((usd.save, "ball.usd"), (usd.save_packed, "ball.usdz")):
        save(asset, tmp_path / name)
        assert found(Usd.Stage.Open(str(tmp_path / name))) == {}
