"""USD stages as usd-core, the reference implementation, finds them: Koala writes USD and reads none."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image


@dataclass(frozen=True, eq=False)
class Shown:
    """The mesh of a stage as a renderer would show it."""

    corners: NDArray[np.float64]
    """(faces, 3, 3) in the stage's world [m]."""
    uv: NDArray[np.float64]
    """(faces, 3, 2), v upwards."""
    base_colour: NDArray[np.uint8]
    """(height, width, 3) bytes of the texture that is bound to the diffuse colour."""
    up: str
    """Axis of the stage that points up."""


def shown(path: Path) -> Shown:
    """The only mesh of a file, all of its faces triangles."""
    pytest.importorskip("pxr", reason="usd-core is absent: pip install 'koala-capture[asset]'")
    from pxr import Usd, UsdGeom, UsdShade

    stage = Usd.Stage.Open(str(path))
    (mesh,) = (UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    assert set(mesh.GetFaceVertexCountsAttr().Get()) == {3}
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    world = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(mesh.GetPrim()))  # of row vectors
    points = np.array(mesh.GetPointsAttr().Get(), float) @ world[:3, :3] + world[3, :3]
    uv = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    assert uv.GetInterpolation() == UsdGeom.Tokens.vertex
    material, _ = UsdShade.MaterialBindingAPI(mesh.GetPrim()).ComputeBoundMaterial()
    surface, _, _ = material.ComputeSurfaceSource()
    texture = UsdShade.Shader(surface.GetInput("diffuseColor").GetConnectedSources()[0][0].source)
    return Shown(
        points[faces] * UsdGeom.GetStageMetersPerUnit(stage),
        np.array(uv.ComputeFlattened(), float)[faces],
        _picture(texture.GetInput("file").Get().resolvedPath),
        UsdGeom.GetStageUpAxis(stage),
    )


def _picture(resolved: Any) -> NDArray[np.uint8]:
    """The bytes of a texture, which may lie inside a package."""
    from pxr import Ar

    data = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(resolved)).GetBuffer()
    return np.asarray(Image.open(io.BytesIO(bytes(data))).convert("RGB"))
