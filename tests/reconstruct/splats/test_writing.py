"""Files of splats, read by other programs."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.splats.splats import Splats
from koala3d.reconstruct.splats.writing import gltf, ply, saving, spz, usd
from tests.reconstruct.asset.test_asset import MODULES, VALIDATE

SINGLE = 1e-6
SPZ_POINT, SPZ_SCALE = 1e-6, 1 / 16
"""Of a position [m], and of a logarithm: steps of its integers."""


def turns(wxyz: np.ndarray) -> np.ndarray:
    return pose.from_quaternion(wxyz)[:, :3, :3]


def test_plyfile_reads_what_was_written(splats: Splats, tmp_path: Path) -> None:
    plyfile = pytest.importorskip("plyfile", reason="plyfile is absent: pip install '.[test]'")
    ply.save(splats, tmp_path / "ball.ply")
    read = plyfile.PlyData.read(tmp_path / "ball.ply")
    assert "unit: m" in read.comments[0]
    column = lambda *names: np.stack([read["vertex"][name] for name in names], -1)  # noqa: E731
    assert np.allclose(column("x", "y", "z"), splats.points, atol=SINGLE)
    assert np.allclose(np.exp(column("scale_0", "scale_1", "scale_2")), splats.scales, rtol=1e-5)
    assert np.allclose(1 / (1 + np.exp(-column("opacity")[:, 0])), splats.opacities, atol=1e-5)
    assert np.allclose(column("rot_0", "rot_1", "rot_2", "rot_3"), splats.quaternions, atol=SINGLE)
    assert np.allclose(column("nx", "ny", "nz"), turns(splats.quaternions)[..., 2], atol=SINGLE)
    assert np.allclose(column("f_dc_0", "f_dc_1", "f_dc_2"), splats.coefficients[:, 0])
    for channel in range(3):
        rest = column(*(f"f_rest_{15 * channel + k}" for k in range(15)))
        assert np.allclose(rest, splats.coefficients[:, 1:, channel])


@pytest.mark.parametrize("suffix", [".ply", ".spz"])
def test_gsply_reads_what_was_written(splats: Splats, tmp_path: Path, suffix: str) -> None:
    gsply = pytest.importorskip("gsply", reason="gsply is absent: pip install '.[test]'")
    path = tmp_path / f"ball{suffix}"
    saving.writer(path)(splats, path)
    read = gsply.plyread(path) if suffix == ".ply" else gsply.read_spz(path)
    packed = suffix == ".spz"
    assert np.allclose(read.means, splats.points, atol=SPZ_POINT if packed else SINGLE)
    assert np.abs(read.scales - np.log(splats.scales)).max() < (0.51 * SPZ_SCALE if packed else 1e-5)
    opacities = 1 / (1 + np.exp(-np.asarray(read.opacities).reshape(-1)))
    assert np.abs(opacities - splats.opacities).max() < (0.51 / 255 if packed else 1e-5)
    assert np.abs(turns(read.quats) - turns(splats.quaternions)).max() < (0.01 if packed else 1e-5)  # ten bits
    assert np.abs(read.sh0 - splats.coefficients[:, 0]).max() < (0.51 / 255 / 0.15 if packed else SINGLE)
    rest = np.asarray(read.shN).reshape(splats.coefficients[:, 1:].shape)
    assert np.abs(rest - splats.coefficients[:, 1:]).max() < (0.51 / 128 if packed else SINGLE)


def test_positions_of_an_spz_keep_six_digits_however_far_they_are(splats: Splats, tmp_path: Path) -> None:
    import gzip

    for reach in (0.1, 7.0, 900.0):
        far = Splats(**{**vars(splats), "points": splats.points / np.abs(splats.points).max() * reach})
        spz.save(far, tmp_path / f"{reach}.spz")
        data = gzip.decompress((tmp_path / f"{reach}.spz").read_bytes())
        assert data[:4] == b"NGSP"
        whole = np.frombuffer(data[16 : 16 + 9 * 40], np.uint8).reshape(40, 3, 3).astype(np.int64) @ [1, 256, 65536]
        found = np.where(whole >= 2**23, whole - 2**24, whole) / 2.0 ** data[13]
        assert np.abs(found - far.points).max() < 1e-6 * reach


def test_pygltflib_reads_what_was_written(splats: Splats, tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib", reason="pygltflib is absent: pip install '.[test]'")
    gltf.save(splats, tmp_path / "ball.glb")
    read = pygltflib.GLTF2().load(str(tmp_path / "ball.glb"))
    blob, (primitive,) = read.binary_blob(), read.meshes[0].primitives
    assert primitive.mode == 0 and primitive.extensions[gltf.EXTENSION]["kernel"] == "ellipse"
    assert read.extensionsUsed == [gltf.EXTENSION]

    def values(name: str) -> np.ndarray:
        accessor = read.accessors[getattr(primitive.attributes, name)]
        view = read.bufferViews[accessor.bufferView]
        return np.frombuffer(blob, "<f4", view.byteLength // 4, view.byteOffset).reshape(accessor.count, -1)

    own = f"{gltf.EXTENSION}:"
    assert np.allclose(values("POSITION"), splats.points, atol=SINGLE)
    assert np.allclose(values(own + "SCALE"), splats.scales, atol=SINGLE)
    assert np.allclose(values(own + "OPACITY")[:, 0], splats.opacities, atol=SINGLE)
    assert np.allclose(np.roll(values(own + "ROTATION"), 1, -1), splats.quaternions, atol=SINGLE)
    places = [(degree, k) for degree in range(4) for k in range(2 * degree + 1)]
    for column, (degree, k) in enumerate(places):
        assert np.allclose(values(f"{own}SH_DEGREE_{degree}_COEF_{k}"), splats.coefficients[:, column])
    extras = read.asset.extras
    assert extras["unit"] == "m" and np.allclose(np.array(extras["base_from_asset"]) @ [0, 1, 0, 1], [0, 0, 1, 1])  # y up to z up


def test_khronos_validator_objects_to_nothing_but_the_names_that_it_does_not_know(splats: Splats, tmp_path: Path) -> None:
    gltf.save(splats, tmp_path / "ball.glb")
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
    found = [(one["code"], one["pointer"]) for one in json.loads(done.stdout)["messages"]]
    unknown = [pointer for code, pointer in found if code == "MESH_PRIMITIVE_INVALID_ATTRIBUTE"]
    assert all(f"/attributes/{gltf.EXTENSION}:" in pointer for pointer in unknown)
    assert {code for code, _ in found} <= {"MESH_PRIMITIVE_INVALID_ATTRIBUTE", "UNSUPPORTED_EXTENSION"}, found


def test_usd_reads_what_was_written(splats: Splats, tmp_path: Path) -> None:
    pytest.importorskip("pxr", reason="usd-core is absent: pip install 'koala-capture[asset]'")
    from pxr import Usd, UsdGeom, UsdVol

    usd.save(splats, tmp_path / "ball.usd")
    stage = Usd.Stage.Open(str(tmp_path / "ball.usd"))
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    field = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    value = lambda name: field.GetPrim().GetAttribute(name).Get()  # noqa: E731
    assert np.allclose(np.array(value("positions")), splats.points, atol=SINGLE)
    assert np.allclose(np.array(value("scales")), splats.scales, atol=SINGLE)
    assert np.allclose(np.array(value("opacities")), splats.opacities, atol=SINGLE)
    read = np.array([[one.GetReal(), *one.GetImaginary()] for one in value("orientations")])
    assert np.allclose(read, splats.quaternions, atol=SINGLE)
    assert value("radiance:sphericalHarmonicsDegree") == 3
    assert np.allclose(np.array(value("radiance:sphericalHarmonicsCoefficients")).reshape(40, 16, 3), splats.coefficients)
    low, high = np.array(value("extent"))
    assert np.all(low < splats.points.min(0)) and np.all(high > splats.points.max(0))


def test_an_old_usd_is_named(splats: Splats, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pxr", reason="usd-core is absent: pip install 'koala-capture[asset]'")
    from pxr import UsdVol

    monkeypatch.delattr(UsdVol, "ParticleField3DGaussianSplat")
    with pytest.raises(UsageError, match="knows no splats"):
        usd.save(splats, tmp_path / "ball.usd")
    assert not list(tmp_path.iterdir())


def test_an_unknown_suffix_is_refused() -> None:
    with pytest.raises(UsageError, match=r"not written as '\.splat'"):
        saving.writer(Path("ball.splat"))
