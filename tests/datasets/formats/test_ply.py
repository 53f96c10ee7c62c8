from pathlib import Path

import numpy as np
import pytest

from datasets.core.errors import DatasetError
from datasets.formats.ply import read_cloud, read_points, write_points

POINTS = np.random.default_rng(0).normal(size=(7, 3))


def test_points_come_back_to_the_bit(tmp_path: Path) -> None:
    write_points(tmp_path / "a.ply", POINTS)
    assert np.array_equal(read_points(tmp_path / "a.ply"), POINTS)


def test_colours_are_read_back_and_no_others_are_invented(tmp_path: Path) -> None:
    colours = np.array([[0, 128, 255]], np.uint8).repeat(len(POINTS), 0)
    write_points(tmp_path / "a.ply", POINTS, colours)
    points, found = read_cloud(tmp_path / "a.ply")
    assert np.array_equal(points, POINTS) and np.array_equal(found, colours)
    write_points(tmp_path / "b.ply", POINTS)
    assert read_cloud(tmp_path / "b.ply")[1] is None


def test_another_programs_vertices_with_colours(tmp_path: Path) -> None:
    """Properties in any order, colours between, faces after: in text and in binary."""
    head = (
        "element vertex 2\nproperty float z\nproperty uchar red\nproperty float x\nproperty float y\nelement face 0\nend_header\n"
    )
    (tmp_path / "t.ply").write_text("ply\nformat ascii 1.0\ncomment made by hand\n" + head + "3 255 1 2\n6 0 4 5\n")
    assert np.array_equal(read_points(tmp_path / "t.ply"), [[1, 2, 3], [4, 5, 6]])
    rows = np.array([(3, 255, 1, 2), (6, 0, 4, 5)], "<f4, u1, <f4, <f4")
    (tmp_path / "b.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\n" + head.encode() + rows.tobytes())
    assert np.array_equal(read_points(tmp_path / "b.ply"), [[1, 2, 3], [4, 5, 6]])


def test_big_endian_and_windows_line_ends(tmp_path: Path) -> None:
    """As other programs write them."""
    head = b"element vertex 2\r\nproperty float x\r\nproperty float y\r\nproperty double z\r\nend_header\r\n"
    rows = np.array([(1, 2, 3), (4, 5, 6)], ">f4, >f4, >f8")
    (tmp_path / "b.ply").write_bytes(b"ply\r\nformat binary_big_endian 1.0\r\n" + head + rows.tobytes())
    (tmp_path / "t.ply").write_bytes(b"ply\r\nformat ascii 1.0\r\n" + head + b"1 2 3\r\n4 5 6\r\n")
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
