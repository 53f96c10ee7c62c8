"""Meshes of strangers are read whole or refused in one line."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.reconstruct.output.mesh import reading
from tests.foreign import meshes


@pytest.fixture
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=1)


@pytest.mark.parametrize("suffix", reading.READABLE)
def test_what_is_written_is_read(ball: trimesh.Trimesh, tmp_path: Path, suffix: str) -> None:
    ball.export(tmp_path / f"ball{suffix}")
    found = reading.read(tmp_path / f"ball{suffix}", process=True)
    assert len(found.faces) == len(ball.faces) and found.volume == pytest.approx(ball.volume, rel=1e-5)


@pytest.mark.parametrize("suffix", reading.READABLE)
def test_parts_with_a_texture_are_read_in_their_places(tmp_path: Path, suffix: str) -> None:
    scene = meshes.parts()
    whole = scene.to_geometry()
    meshes.write(tmp_path / f"parts{suffix}", scene)
    found = reading.read(tmp_path / f"parts{suffix}")
    assert len(found.faces) == len(whole.faces)
    np.testing.assert_allclose(found.bounds, scene.bounds, atol=1e-6)  # single precision
    assert (found.volume, found.area) == pytest.approx((whole.volume, whole.area), rel=1e-5)


def changed_glb(path: Path, **parts: object) -> None:
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    text = json.dumps({**json.loads(data[20 : 20 + length]), **parts}).encode()
    text += b" " * (-len(text) % 4)
    path.write_bytes(data[:12] + len(text).to_bytes(4, "little") + data[16:20] + text + data[20 + length :])


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"accessors": [{"componentType": 5126, "type": "MAT4", "count": 10**9}]}, "does not hold"),
        ({"accessors": [{"componentType": 5126, "type": "MAT4", "count": 10**9, "bufferView": 0}]}, "cut off"),
        ({"buffers": [{"uri": "../secret.bin", "byteLength": 5}]}, "refers to other files"),
        ({"nodes": [{"children": [1, 1]}, {"children": [2, 2]}, {"mesh": 0}]}, "no tree"),
        ({"nodes": [{"mesh": 0}] * 500_000}, "too large"),
        ({"meshes": 7}, "no readable mesh"),
    ],
)
def test_a_glb_that_asks_for_too_much_is_refused(ball: trimesh.Trimesh, tmp_path: Path, parts: dict, words: str) -> None:
    ball.export(tmp_path / "ball.glb")
    changed_glb(tmp_path / "ball.glb", **parts)
    with pytest.raises(DatasetError, match=words):
        reading.read(tmp_path / "ball.glb")


def test_what_is_no_mesh_is_refused(ball: trimesh.Trimesh, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"suffix '\.py'"):
        reading.read(tmp_path / "a.py")
    with pytest.raises(UsageError, match="no such file"):
        reading.read(tmp_path / "a.ply")
    ball.export(tmp_path / "a.ply")
    whole = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(whole.replace(b"element vertex 42\n", b"element vertex 99999999999\n"))
    with pytest.raises(DatasetError, match="cut off"):
        reading.read(tmp_path / "a.ply")
    broken = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [np.nan, 1, 0]], [[0, 1, 2]], process=False)
    broken.export(tmp_path / "b.ply")
    with pytest.raises(DatasetError, match="no mesh"):
        reading.read(tmp_path / "b.ply")
