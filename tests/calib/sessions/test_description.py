"""What a description of a session may say."""

import json

import pytest

from koala3d.calib.sessions.description import CameraNumbers, load_description
from koala3d.datasets.core.errors import UsageError

BOARD = {"type": "chessboard", "squares_x": 10, "squares_y": 7, "square_length_m": 0.02}


def refusal(tmp_path, text):
    (tmp_path / "import.yaml").write_text("images: '*.png'\nposes: b.csv\n" + text + f"board: {json.dumps(BOARD)}\n")
    with pytest.raises(UsageError) as refused:
        load_description(tmp_path / "import.yaml")
    return str(refused.value)


def test_descriptions_are_checked(tmp_path):
    board = f"board: {json.dumps(BOARD)}\n"
    (tmp_path / "import.yaml").write_text("images: a.png\nposes: b.csv\nlayout: matrix\n" + board)
    with pytest.raises(UsageError, match="exactly one"):
        load_description(tmp_path / "import.yaml")
    (tmp_path / "import.yaml").write_text("images: '*.png'\nposes: b.csv\nlayout: matrx\n" + board)
    with pytest.raises(UsageError, match="layout"):
        load_description(tmp_path / "import.yaml")
    (tmp_path / "import.yaml").write_text("images: '*.png'\nposes: b.csv\nlayout: matrix\nboard: {type: charuco, squares_x: 9}\n")
    with pytest.raises(UsageError, match=r"line 4: key 'board\.squares_y' is missing"):
        load_description(tmp_path / "import.yaml")


def test_cameras_of_opencv_are_shifted_by_half_a_pixel():
    camera = CameraNumbers(width=640, height=480, fx=600, fy=600, cx=320, cy=240, distortion=[0.1]).camera()
    assert (camera.cx, camera.k1) == (320.5, 0.1)
    assert CameraNumbers(width=640, height=480, fx=600, fy=600, cx=320, cy=240, first_pixel=0.5).camera().cx == 320


def test_euler_angles_need_their_axes(tmp_path):
    assert "needs euler" in refusal(tmp_path, "layout: x y z a b c\n")
    assert "ZYX for KUKA" in refusal(tmp_path, "layout: x y z a b c\neuler: ABC\n")
    assert "no sequence of three axes" in refusal(tmp_path, "layout: x y z a b c\neuler: xYz\n")
    assert "no sequence of three axes" in refusal(tmp_path, "layout: x y z a b c\neuler: xxy\n")
    assert "is for three angles" in refusal(tmp_path, "layout: matrix\neuler: xyz\n")


def test_zeros_after_the_last_coefficient_do_no_harm():
    size = {"width": 640, "height": 480, "fx": 600, "fy": 600, "cx": 320, "cy": 240}
    assert CameraNumbers(**size, distortion=[0.1, *[0] * 11]).camera().k1 == 0.1
    with pytest.raises(ValueError, match=r"12 coefficients: possible are k1 k2 p1 p2 k3 k4 k5 k6"):
        CameraNumbers(**size, distortion=[0.1, *[0] * 10, 0.02])
