from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats.ply import read_cloud, read_points, write_points
from tests.foreign import meshes

POINTS = np.random.default_rng(0).normal(size=(7, 3))


def test_points_come_back_to_the_bit(tmp_path: Path) -> None:
    write_points(tmp_path / "a.ply", POINTS)
    assert np.array_equal(read_points(tmp_path / "a.ply"), POINTS)


def test_colours_are_read_back_and_no_others_are_invented(tmp_path: Path) -> None:
    colours = np.array([[0, 128, 255]], np.uint8).repeat(len(POINTS), 0)
    write_points(tmp_path / "a.ply", POINTS, colours)
    cloud = read_cloud(tmp_path / "a.ply")
    points, found = cloud.points, cloud.colours
    assert np.array_equal(points, POINTS) and np.array_equal(found, colours)
    theirs = trimesh.load(tmp_path / "a.ply")
    assert np.array_equal(theirs.vertices, POINTS) and np.array_equal(theirs.colors[:, :3], colours)
    write_points(tmp_path / "b.ply", POINTS)
    assert read_cloud(tmp_path / "b.ply").colours is None


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("coloured", [False, True])
def test_another_programs_points_are_read(tmp_path: Path, text: bool, coloured: bool) -> None:
    colours = np.random.default_rng(1).integers(0, 256, (len(POINTS), 3), np.uint8) if coloured else None
    meshes.write_points(tmp_path / "a.ply", POINTS, colours, text=text)
    cloud = read_cloud(tmp_path / "a.ply")
    points, found = cloud.points, cloud.colours
    np.testing.assert_allclose(points, POINTS, rtol=1e-6, atol=1e-8)  # single precision; eight digits as text
    assert (found is None and colours is None) or np.array_equal(found, colours)


def test_vertices_of_a_mesh_are_read(tmp_path: Path) -> None:
    """Normals stand between places and colours, and faces follow."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.visual.vertex_colors = np.random.default_rng(0).integers(0, 256, (len(ball.vertices), 4), np.uint8)
    ball.export(tmp_path / "a.ply", vertex_normal=True)
    cloud = read_cloud(tmp_path / "a.ply")
    points, colours = cloud.points, cloud.colours
    np.testing.assert_allclose(points, ball.vertices, atol=1e-7)  # single precision
    assert np.array_equal(colours, ball.visual.vertex_colors[:, :3])


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_other_orders_of_bytes_and_properties_and_line_ends(tmp_path: Path, end: bytes) -> None:
    """As older programs write them, and none that can be installed."""
    head = b"element vertex 2\nproperty double z\nproperty uchar red\nproperty float x\nproperty float y\nend_header\n"
    rows = np.array([(3, 255, 1, 2), (6, 0, 4, 5)], ">f8, u1, >f4, >f4")
    (tmp_path / "b.ply").write_bytes((b"ply\nformat binary_big_endian 1.0\n" + head).replace(b"\n", end) + rows.tobytes())
    text = b"ply\nformat ascii 1.0\ncomment made by hand\n" + head + b"3 255 1 2\n6 0 4 5\n"
    (tmp_path / "t.ply").write_bytes(text.replace(b"\n", end))
    for name in ("b.ply", "t.ply"):
        assert np.array_equal(read_points(tmp_path / name), [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize(("old", "new", "words"), [
    (b"vertex 7", b"vertex 99999999999999", "is cut off"),
    (b"vertex 7", b"vertex -1", "holds no readable points"),
    (b"vertex 7", b"vertex x", "header cannot be read"),
    (b"little", b"middle", "format binary_middle_endian"),
    (b"double z", b"list uchar int z", "header cannot be read"),
    (b"property double z\n", b"", "holds no readable points"),
    (b"end_header", b"", "is not a PLY file"),
])  # fmt: skip
def test_damage_is_named(tmp_path: Path, old: bytes, new: bytes, words: str) -> None:
    write_points(tmp_path / "a.ply", POINTS)
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data.replace(old, new))
    with pytest.raises(DatasetError, match=words):
        read_points(tmp_path / "a.ply")


def test_nan_is_refused(tmp_path: Path) -> None:
    write_points(tmp_path / "a.ply", POINTS * np.nan)
    with pytest.raises(DatasetError, match="not finite"):
        read_points(tmp_path / "a.ply")
