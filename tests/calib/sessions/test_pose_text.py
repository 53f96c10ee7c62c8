"""Lines and arrays as NumPy and TUM's tools write them."""

import numpy as np
import pytest

from koala3d.calib.sessions import pose_text
from koala3d.calib.sessions.description import Description
from koala3d.datasets.core.errors import DatasetError, KoalaError

BOARD = {"type": "chessboard", "squares_x": 10, "squares_y": 7, "square_length_m": 0.02}
QUATERNIONS = "x y z qx qy qz qw"
TUM = (
    "# ground truth trajectory\n# timestamp tx ty tz qx qy qz qw\n"
    "1305031098.6659 1.3563 0.6305 1.6380 0.6132 0.5962 -0.3311 -0.3986\n"
    "1305031098.6758 1.3543 0.6306 1.6360 0.6129 0.5966 -0.3316 -0.3980\n"
)


def described(layout):
    return Description(images="*.png", poses="poses.txt", layout=layout, board=BOARD)


def read(tmp_path, text, layout, images=()):
    (tmp_path / "poses.txt").write_text(text)
    return pose_text.read_lines(tmp_path / "poses.txt", described(layout), images)


@pytest.fixture
def matrices():
    """(6, 4, 4) of a file."""
    found = np.tile(np.eye(4), (6, 1, 1))
    found[:, :3] += np.random.default_rng(0).normal(size=(6, 3, 4))
    return found


@pytest.mark.parametrize("kind", ["one after the other", "upper rows", "a line each", "upper rows, a line each", "with commas"])
def test_matrices_of_savetxt_are_read(tmp_path, matrices, kind):
    path, upper = tmp_path / "poses.txt", matrices[:, :3]
    if kind == "one after the other":
        with open(path, "w") as file:
            for number, matrix in enumerate(matrices):
                np.savetxt(file, matrix, header=f"pose {number}", footer="\n")
    elif kind == "upper rows":
        np.savetxt(path, upper.reshape(-1, 4))
    else:
        rows = upper if "upper" in kind else matrices
        np.savetxt(path, rows.reshape(6, -1), delimiter=", " if "commas" in kind else " ")
    found = np.asarray(pose_text.read_lines(path, described("matrix"), ()), np.float64)
    np.testing.assert_allclose(found, (upper if "upper" in kind else matrices).reshape(6, -1), rtol=1e-15)


def test_matrices_by_columns_are_four_lines_each(tmp_path, matrices):
    np.savetxt(tmp_path / "poses.txt", np.swapaxes(matrices, 1, 2).reshape(-1, 4))
    found = np.asarray(pose_text.read_lines(tmp_path / "poses.txt", described("matrix by columns"), ()), np.float64)
    np.testing.assert_allclose(found, np.swapaxes(matrices, 1, 2).reshape(6, 16), rtol=1e-15)


def test_a_trajectory_of_tum_is_in_order_or_by_the_times_of_the_images(tmp_path):
    first = ["1.3563", "0.6305", "1.6380", "0.6132", "0.5962", "-0.3311", "-0.3986"]
    assert read(tmp_path, TUM, QUATERNIONS)[0] == first
    by_time = read(tmp_path, TUM, QUATERNIONS, {"1305031098.6659", "1305031098.6758"})
    assert by_time["1305031098.6659"] == first


def test_lines_may_begin_with_the_name_of_the_image(tmp_path):
    assert read(tmp_path, "b.png 1 2 3 4 5 6\na.png 1 2 3 4 5 7\n", "x y z rx ry rz")["b.png"] == list("123456")


@pytest.mark.parametrize(
    ("text", "layout", "words"),
    [
        ("1 2 3 4 5 6 7\n1 2 3 4 5 6 7\n", "x y z rx ry rz", r"lines have 7 numbers.*has 6 numbers"),
        ("x y z rx ry rz\n1 2 3 4 5 6\n", "x y z rx ry rz", r"not made of numbers \(x y z rx ry rz\); begin lines that are no"),
        ("image x y z rx ry rz\na 1 2 3 4 5 6\n", "x y z rx ry rz", "not made of numbers"),
        ("0,1 0,2 3 4 5 6\n1 2 3 4 5 6\n", "x y z rx ry rz", "lines have 6 to 8 numbers"),
        ("1 2 3 4\n" * 5, "matrix", "lines have 4 numbers"),
        ("# nothing\n", "matrix", "it is empty"),
        ("a 1 2 3 4 5 6\na 1 2 3 4 5 6\n", "x y z rx ry rz", "two lines begin with one name"),
    ],
)
def test_other_lines_are_refused(tmp_path, text, layout, words):
    with pytest.raises(DatasetError, match=words):
        read(tmp_path, text, layout)


def test_arrays_are_read(tmp_path, matrices):
    path = tmp_path / "poses.npy"
    for array in (matrices, matrices[:, :3], matrices.astype(np.float32), matrices.reshape(6, 16), matrices[0]):
        np.save(path, array)
        wanted = array.reshape(-1, 12 if array.shape[-2:] == (3, 4) else 16)
        np.testing.assert_array_equal(pose_text.read_npy(path, described("matrix")), wanted)
    np.save(path, matrices.reshape(-1)[:12].reshape(2, 6))
    assert len(pose_text.read_npy(path, described("x y z rx ry rz"))) == 2


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.zeros((5, 4, 4)), r"shape \(5, 4, 4\).*has 6 numbers"),
        (np.array([{"a": 1}], object), "Python objects"),
        (np.array(["1"] * 6), "type <U1"),
        (np.float64(3), r"shape \(\)"),
    ],
    ids=["matrices", "objects", "words", "a number"],
)
def test_other_arrays_are_refused(tmp_path, array, words):
    np.save(tmp_path / "poses.npy", array, allow_pickle=True)
    with pytest.raises(KoalaError, match=words):
        pose_text.read_npy(tmp_path / "poses.npy", described("x y z rx ry rz"))
