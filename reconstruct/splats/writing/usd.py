"""USD: the particle field of 3D Gaussian splats, of usd-core 26.3 and newer."""

import os
from pathlib import Path

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.splats import harmonics
from koala3d.reconstruct.splats.splats import Splats


def save(splats: Splats, path: Path) -> None:
    """Write splats as FILE.usd: /splats, with z up. Raises UsageError: usd-core is older than 26.3."""
    from pxr import Sdf, Usd, UsdGeom, UsdVol, Vt

    if not hasattr(UsdVol, "ParticleField3DGaussianSplat"):
        version = ".".join(map(str, Usd.GetVersion()[1:]))
        raise UsageError(f"usd-core {version} knows no splats", where=path, remedy="pip install 'usd-core>=26.3'")
    with files.atomic_path(path) as temporary:
        stage = Usd.Stage.CreateNew(os.fspath(temporary))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        field = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/splats")
        stage.SetDefaultPrim(field.GetPrim())
        field.GetPrim().SetCustomData({"unit": "m" if splats.metric else "unknown", "scene": splats.name})
        radius = 3 * splats.scales.max(-1, keepdims=True)
        extent = np.stack([(splats.points - radius).min(0), (splats.points + radius).max(0)])
        values = {
            "positions": Vt.Vec3fArray.FromNumpy(_floats(splats.points)),
            "orientations": Vt.QuatfArray.FromNumpy(_floats(np.roll(splats.quaternions, -1, -1))),
            "scales": Vt.Vec3fArray.FromNumpy(_floats(splats.scales)),
            "opacities": Vt.FloatArray.FromNumpy(_floats(splats.opacities)),
            "radiance:sphericalHarmonicsDegree": harmonics.DEGREE,
            "radiance:sphericalHarmonicsCoefficients": Vt.Vec3fArray.FromNumpy(_floats(splats.coefficients.reshape(-1, 3))),
            "extent": Vt.Vec3fArray.FromNumpy(_floats(extent)),
        }
        for name, value in values.items():
            field.GetPrim().GetAttribute(name).Set(value)
        UsdGeom.PrimvarsAPI(field).CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex).Set(
            Vt.Vec3fArray.FromNumpy(_floats(harmonics.even(splats.coefficients)))
        )
        stage.GetRootLayer().Save()


def _floats(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)
