"""Which pose belongs to which image."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from koala3d.calib.sessions import pose_files
from koala3d.calib.sessions.description import Description
from koala3d.datasets.core.errors import DatasetError, UsageError

BOARD = {"type": "chessboard", "squares_x": 10, "squares_y": 7, "square_length_m": 0.02}


def found(folder, images=("a", "b"), **said):
    plain = {"images": "*.png", "layout": "x y z rx ry rz", "board": BOARD, **said}
    return pose_files.numbers(folder, Description(**plain), {name: Path(f"{name}.png") for name in images})


def test_numbers_in_names_sort_as_numbers(tmp_path):
    for number in (1, 2, 10, 11, 9):
        (tmp_path / f"img_{number}.png").touch()
    for name in ("img_.png", "7.png", "img_2b.png", "Img_3.png"):
        (tmp_path / name).touch()
    expected = ["7", "Img_3", "img_", "img_1", "img_2", "img_2b", "img_9", "img_10", "img_11"]
    assert list(pose_files.matching(tmp_path, "*.png")) == expected
    assert list(pose_files.matching(tmp_path, "img_*.png")) == ["", "1", "2", "2b", "9", "10", "11"]


@pytest.mark.parametrize("key", ["PoseState", "PoseState.data"])
def test_a_file_of_opencv_for_each_image(tmp_path, key):
    matrices = {name: np.random.default_rng(seed).normal(size=(4, 4)) for seed, name in enumerate(("a", "b"))}
    for name, matrix in matrices.items():
        storage = cv2.FileStorage(str(tmp_path / f"{name}.yaml"), cv2.FILE_STORAGE_WRITE)
        storage.write("PoseState", matrix)
        storage.release()
    assert found(tmp_path, poses="*.yaml", key=key, layout="matrix") == {n: m.ravel().tolist() for n, m in matrices.items()}
    with pytest.raises(DatasetError, match=r"not made of numbers.*say where its numbers are, for instance key: PoseState"):
        found(tmp_path, poses="*.yaml", layout="matrix")


@pytest.mark.parametrize("suffix", ["txt", "npy"])
def test_a_file_of_numpy_for_each_image(tmp_path, suffix):
    for name in ("a", "b"):
        matrix = np.random.default_rng(3).normal(size=(4, 4))
        (np.savetxt if suffix == "txt" else np.save)(tmp_path / f"{name}.{suffix}", matrix)
    assert found(tmp_path, poses=f"*.{suffix}", layout="matrix") == dict.fromkeys("ab", matrix.ravel().tolist())


def test_one_matrix_of_opencv_with_a_row_for_each_image(tmp_path):
    rows = np.random.default_rng(4).normal(size=(2, 6))
    storage = cv2.FileStorage(str(tmp_path / "poses.xml"), cv2.FILE_STORAGE_WRITE)
    storage.write("all", rows)
    storage.release()
    assert found(tmp_path, poses="poses.xml", key="all") == dict(zip("ab", rows.tolist(), strict=True))


def test_a_list_may_call_images_by_view_or_by_file_with_its_suffix_or_without(tmp_path):
    pose = [0.0] * 6
    for names in (("a", "b"), ("a.png", "b.png"), ("some/where/a.png", "b")):
        (tmp_path / "poses.json").write_text(json.dumps(dict.fromkeys(names, pose)))
        assert found(tmp_path, poses="poses.json") == {"a": pose, "b": pose}


def test_other_kinds_of_file_are_refused_with_those_that_are_read(tmp_path):
    (tmp_path / "poses.xlsx").write_bytes(b"PK")
    with pytest.raises(UsageError, match=r"is no file of poses \(.xlsx; possible are .csv .txt .npy"):
        found(tmp_path, poses="poses.xlsx")
