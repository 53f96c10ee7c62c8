import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from koala3d.datasets.conventions import OPENCV_FROM_LLFF, OPENCV_FROM_OPENGL, opencv_from_pixels, pixels_from_opencv


def test_opengl_axes_by_hand() -> None:
    """A camera that looks along -z with y up: its up (0, 1, 0) is our (0, -1, 0), its forward (0, 0, -1) our (0, 0, 1)."""
    assert np.array_equal(OPENCV_FROM_OPENGL[:3, :3] @ [0, 1, 0], [0, -1, 0])
    assert np.array_equal(OPENCV_FROM_OPENGL[:3, :3] @ [0, 0, -1], [0, 0, 1])


def test_llff_axes_by_hand() -> None:
    """Axes down, right, back: the first is our y, the second our x, the third our -z."""
    for theirs, ours in (([1, 0, 0], [0, 1, 0]), ([0, 1, 0], [1, 0, 0]), ([0, 0, 1], [0, 0, -1])):
        assert np.array_equal(OPENCV_FROM_LLFF[:3, :3] @ theirs, ours)


def test_both_are_rotations_and_their_own_inverses() -> None:
    for matrix in (OPENCV_FROM_OPENGL, OPENCV_FROM_LLFF):
        assert np.array_equal(matrix @ matrix, np.eye(4)) and np.linalg.det(matrix) == 1


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
def test_pixel_origins(x: float, y: float) -> None:
    assert pixels_from_opencv([0, 0]).tolist() == [0.5, 0.5]
    assert np.abs(opencv_from_pixels(pixels_from_opencv([x, y])) - [x, y]).max() < 1e-11
