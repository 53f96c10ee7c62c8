"""USD: a mesh with a UsdPreviewSurface, with its textures beside it (usd) or packed into one file with them (usdz)."""

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.certainty import MEANING
from koala3d.reconstruct.asset.writing.obj import write_textures

SHADED = {
    "diffuseColor": ("base_colour", "rgb", "sRGB"),
    "roughness": ("roughness", "r", "raw"),
    "metallic": ("metallic", "r", "raw"),
    "occlusion": ("occlusion", "r", "raw"),
    "normal": ("normal", "rgb", "raw"),
}
"""Input of UsdPreviewSurface: texture, its output, and colour space."""


def save(asset: Asset, path: Path) -> None:
    """Write an asset as FILE.usd, its textures beside it: FILE_base_colour.png and so on, see `obj.write_textures`."""
    names = write_textures(asset, path.parent, path.stem)
    with files.atomic_path(path) as temporary:
        _write_layer(asset, temporary, names)


def save_packed(asset: Asset, path: Path) -> None:
    """Write an asset as FILE.usdz. Raises DatasetError: the library cannot pack it."""
    from pxr import Sdf, UsdUtils

    with files.atomic_path(path) as temporary, tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.stem}.") as folder:
        layer, packed = Path(folder) / "asset.usdc", Path(folder) / "packed.usdz"  # the library refuses names that exist
        _write_layer(asset, layer, write_textures(asset, Path(folder), "asset"))
        if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(os.fspath(layer)), os.fspath(packed)):
            raise DatasetError("USD cannot be packed", where=path, remedy="choose a name that ends in .glb")
        os.replace(packed, temporary)


def _write_layer(asset: Asset, path: Path, names: dict[str, str]) -> None:
    """The stage: /asset with its mesh and material."""
    from pxr import Kind, Sdf, Usd, UsdGeom, UsdShade, Vt

    stage = Usd.Stage.CreateNew(os.fspath(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/asset")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind(Kind.Tokens.component)
    about = {
        "base_from_asset": str(asset.base_from_asset.tolist()),
        "unit": "m" if asset.metric else "unknown",
        "certainty": MEANING,
    }
    root.GetPrim().SetCustomData(about)
    mesh = UsdGeom.Mesh.Define(stage, "/asset/mesh")
    unwrapped = asset.mesh
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(unwrapped.vertices.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(unwrapped.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(unwrapped.faces.astype(np.int32).reshape(-1)))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(unwrapped.normals.astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    low, high = unwrapped.vertices.min(0), unwrapped.vertices.max(0)
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([low, high]).astype(np.float32)))
    uv = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
    uv.Set(Vt.Vec2fArray.FromNumpy(unwrapped.uv.astype(np.float32)))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(_material(stage, names))
    stage.GetRootLayer().Save()


def _material(stage: Any, names: dict[str, str]) -> Any:
    """The material, its textures by file name."""
    from pxr import Gf, Sdf, UsdShade

    types = Sdf.ValueTypeNames
    material = UsdShade.Material.Define(stage, "/asset/material")
    shader = UsdShade.Shader.Define(stage, "/asset/material/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    reader = UsdShade.Shader.Define(stage, "/asset/material/st")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", types.String).Set("st")
    reader.CreateOutput("result", types.Float2)
    kinds = {"diffuseColor": types.Color3f, "normal": types.Normal3f}
    for wanted, (texture, channel, space) in SHADED.items():
        node = UsdShade.Shader.Define(stage, f"/asset/material/{texture}")
        node.CreateIdAttr("UsdUVTexture")
        node.CreateInput("file", types.Asset).Set(Sdf.AssetPath(f"./{names[texture]}"))
        node.CreateInput("st", types.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        node.CreateInput("sourceColorSpace", types.Token).Set(space)
        for axis in ("wrapS", "wrapT"):
            node.CreateInput(axis, types.Token).Set("repeat")
        if texture == "normal":  # bytes to -1..1
            node.CreateInput("scale", types.Float4).Set(Gf.Vec4f(2, 2, 2, 1))
            node.CreateInput("bias", types.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
        kind = kinds.get(wanted, types.Float)
        node.CreateOutput(channel, types.Float3 if channel == "rgb" else types.Float)
        shader.CreateInput(wanted, kind).ConnectToSource(node.ConnectableAPI(), channel)
    return material
