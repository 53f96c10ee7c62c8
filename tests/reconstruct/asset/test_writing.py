"""Files of an asset, read by other programs."""

import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.writing import obj, saving, usd
from tests.foreign import stages


def content(path: Path) -> dict:
    """The JSON of a GLB."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])


def test_glb_says_where_the_asset_is(glb: Path, asset: Asset) -> None:
    about = content(glb)["asset"]
    assert about["version"] == "2.0" and about["extras"]["unit"] == "m"
    assert np.allclose(about["extras"]["base_from_asset"], asset.base_from_asset)
    assert 0 < about["extras"]["certainty"]["unseen"] < 1


def test_parts_of_a_glb_are_inside_and_aligned(glb: Path) -> None:
    found = content(glb)
    size = found["buffers"][0]["byteLength"]
    for view in found["bufferViews"]:
        assert view["byteOffset"] % 4 == 0 and view["byteOffset"] + view["byteLength"] <= size
    assert [accessor["type"] for accessor in found["accessors"]] == ["VEC3", "VEC3", "VEC4", "VEC2", "SCALAR"]


@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_another_program_reads_the_same_mesh_and_colours(asset: Asset, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"ball{suffix}"
    saving.writer(path)(asset, path)
    read = trimesh.load(path, force="mesh", process=False)
    assert isinstance(read, trimesh.Trimesh) and len(read.faces) == len(asset.mesh.faces)
    assert np.allclose(read.triangles, asset.mesh.vertices[asset.mesh.faces], atol=1e-6)  # single precision, seven digits
    picture = read.visual.material.baseColorTexture if suffix == ".glb" else read.visual.material.image
    assert np.array_equal(np.asarray(picture.convert("RGB")), asset.textures.base_colour)
    assert np.allclose(read.visual.uv[read.faces], asset.mesh.uv[asset.mesh.faces], atol=1e-6)  # v upwards for trimesh


def test_obj_names_files_that_are_there(asset: Asset, tmp_path: Path) -> None:
    obj.save(asset, tmp_path / "ball.obj")
    for line in (tmp_path / "ball.mtl").read_text().splitlines():
        if line.startswith(("map_", "norm ")):
            assert (tmp_path / line.split()[-1]).is_file(), line
    frame = json.loads((tmp_path / "ball_frame.json").read_text())
    assert frame["format"] == obj.FORMAT and np.allclose(frame["base_from_asset"], asset.base_from_asset)
    roughness = images.read(tmp_path / "ball_roughness.png")
    assert np.allclose(roughness[..., 0], asset.textures.surface[..., 1] / 255, atol=1e-6)


@pytest.mark.parametrize("suffix", [".usd", ".usdz"])
def test_usd_opens_with_its_textures(asset: Asset, tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("pxr", reason="usd-core is absent: pip install 'koala-capture[asset]'")
    from pxr import Usd, UsdShade

    path = tmp_path / f"ball{suffix}"
    saving.writer(path)(asset, path)
    shown = stages.shown(path)
    assert shown.up == "Y"
    assert np.allclose(shown.corners, asset.mesh.vertices[asset.mesh.faces], atol=1e-6)  # single precision
    assert np.allclose(shown.uv, asset.mesh.uv[asset.mesh.faces], atol=1e-6)  # v upwards
    assert np.array_equal(shown.base_colour, asset.textures.base_colour)
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetDefaultPrim()
    assert np.allclose(json.loads(prim.GetCustomDataByKey("base_from_asset")), asset.base_from_asset)
    for name in ("base_colour", "roughness", "metallic", "occlusion", "normal"):
        file = UsdShade.Shader(stage.GetPrimAtPath(f"/asset/material/{name}")).GetInput("file").Get()
        assert file.resolvedPath, name  # found
    if suffix == ".usdz":
        assert all(entry.compress_type == zipfile.ZIP_STORED for entry in zipfile.ZipFile(path).infolist())
    assert not list(tmp_path.glob(".*"))  # nothing temporary is left


def test_usd_textures_are_beside_it(asset: Asset, tmp_path: Path) -> None:
    usd.save(asset, tmp_path / "ball.usd")
    assert (tmp_path / "ball_certainty.png").is_file() and (tmp_path / "ball_base_colour.png").is_file()


def test_a_suffix_that_is_not_written_is_refused_with_those_that_are() -> None:
    with pytest.raises(UsageError, match=r"not written as '\.fbx'.*\.glb, \.obj, \.usd, \.usdz"):
        saving.writer(Path("ball.fbx"))


def test_summary_is_for_people_and_programs(asset: Asset) -> None:
    result, text = saving.summary(asset)
    assert result["faces"] == 1280 and "y up" in text and json.dumps(result)
