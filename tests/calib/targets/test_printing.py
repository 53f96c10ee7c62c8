import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from koala3d.calib.targets import printing
from koala3d.calib.targets.detection import detect
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.targets.board import Board

BOARDS = [
    Board.of("charuco", 9, 7, 0.03, 0.022, "DICT_5X5_100"),
    Board.of("charuco", 6, 8, 0.03, 0.022, "DICT_4X4_50"),
    Board.of("chessboard", 10, 7, 0.025),
    Board.of("tags", 4, 3, 0.04, 0.03, "DICT_APRILTAG_36h11", first_id=5),
    Board.of("aprilgrid", 4, 3, 0.052, 0.04),
    Board.of("circles", 6, 4, 0.03, 0.02),
    Board.of("asymmetric_circles", 4, 7, 0.02, 0.018),
]
IDS = ["charuco", "charuco even", "chessboard", "tags", "aprilgrid", "circles", "asymmetric circles"]


def painted(rectangles, circles, per_mm, width, height):
    """(rows, columns) picture 0..1 of rectangles and of circles (middle, radius) in millimetres."""
    picture = np.ones((round(height * per_mm), round(width * per_mm)), np.float32)
    for x, y, w, h in rectangles * per_mm:
        picture[round(y) : round(y + h), round(x) : round(x + w)] = 0
    columns, rows = np.meshgrid(*((np.arange(edge) + 0.5) / per_mm for edge in picture.shape[::-1]))
    for x, y, r in circles:
        picture[np.hypot(columns - x, rows - y) < r] = 0
    return picture


def assert_found(board, picture, per_mm):
    """The detector that reads recordings finds every corner where the page has it."""
    seen = detect(board, picture, "page")
    assert seen is not None and len(seen.ids) == len(board.points)
    expected = (1e3 * seen.points[:, :2] + printing.origin_mm(board)) * per_mm
    assert np.abs(seen.pixels - expected).max() < 0.6  # whole pixels, no blur


@pytest.mark.parametrize("board", BOARDS, ids=IDS)
def test_svg_shows_what_the_detector_reads(board, tmp_path):
    path = tmp_path / "board.svg"
    printing.write(board, path)
    root = ElementTree.parse(path).getroot()
    width, height = printing.page_mm(board)
    assert root.get("width") == f"{width:.4f}mm"
    boxes = [e for e in root.iter("{http://www.w3.org/2000/svg}rect") if e.get("x")]
    rectangles = np.array([[float(e.get(k)) for k in ("x", "y", "width", "height")] for e in boxes])
    assert rectangles[-1, 2] == 100  # the bar to measure
    round_ones = [e for e in root.iter("{http://www.w3.org/2000/svg}circle")]
    circles = np.array([[float(e.get(k)) for k in ("cx", "cy", "r")] for e in round_ones]).reshape(-1, 3)
    assert_found(board, painted(rectangles, circles, 4, width, height), 4)


@pytest.mark.parametrize("board", BOARDS, ids=IDS)
def test_pdf_has_the_same_shapes_in_points(board, tmp_path):
    path = tmp_path / "board.pdf"
    printing.write(board, path)
    data = path.read_bytes()
    width, height = printing.page_mm(board)
    media = [float(v) for v in re.search(rb"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data).groups()]
    np.testing.assert_allclose(media, np.array([width, height]) / 25.4 * 72, atol=1e-3)
    found = np.array([[float(v) for v in line.split()[:4]] for line in data.split(b"\n") if line.endswith(b" re")]) / 72 * 25.4
    found[:, 1] = height - found[:, 1] - found[:, 3]
    numbers = [[float(v) for v in line.split()[:-1]] for line in data.split(b"\n") if line.endswith((b" m", b" c"))]
    ends = (
        np.array([line[-2:] for line in numbers]).reshape(-1, 5, 2) / 72 * 25.4
    )  # right, top, left, bottom, right of each circle
    middles = (ends[:, 0] + ends[:, 2]) / 2
    circles = np.column_stack([middles[:, 0], height - middles[:, 1], (ends[:, 0] - ends[:, 2])[:, 0] / 2])
    assert_found(board, painted(found, circles, 4, width, height), 4)
    for place in re.findall(rb"(\d{10}) 00000 n", data):  # the table points at its objects
        assert re.match(rb"\d+ 0 obj", data[int(place) :])


def test_other_suffixes_and_existing_files_are_refused(tmp_path):
    with pytest.raises(UsageError, match=r"\.pdf or \.svg"):
        printing.write(BOARDS[0], tmp_path / "board.png")
    (tmp_path / "board.svg").write_text("mine")
    with pytest.raises(UsageError, match="already exists"):
        printing.write(BOARDS[0], tmp_path / "board.svg")
