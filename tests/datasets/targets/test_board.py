import numpy as np
import pytest
import yaml

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import validate
from koala3d.datasets.targets.board import Board

CHARUCO = Board.of("charuco", 9, 6, 0.03, 0.022)


def test_a_board_survives_its_description() -> None:
    for board in (CHARUCO, Board.of("chessboard", 10, 7, 0.025), Board.of("tags", 4, 3, 0.04, 0.04, first_id=5)):
        assert Board.model_validate(board.to_json()) == Board.model_validate(board.model_dump()) == board
        assert board.to_json()["type"] == board.kind


def test_inner_corners_are_numbered_row_by_row() -> None:
    assert CHARUCO.points.shape == (8 * 5, 3)
    np.testing.assert_allclose(CHARUCO.points[[0, 1, 8]], [[0.03, 0.03, 0], [0.06, 0.03, 0], [0.03, 0.06, 0]])


def test_corners_of_a_tag_go_clockwise_from_the_upper_left_one() -> None:
    tags = Board.of("tags", 2, 1, 0.05, 0.03)
    np.testing.assert_allclose(tags.points[:4, :2], [[0.01, 0.01], [0.04, 0.01], [0.04, 0.04], [0.01, 0.04]])
    np.testing.assert_allclose(tags.points[4], [0.06, 0.01, 0])


def test_circles_lie_in_the_middle_of_their_squares_and_every_other_row_is_shifted() -> None:
    np.testing.assert_allclose(Board.of("circles", 4, 3, 0.03, 0.02).points[[0, 4], :2], [[0.015, 0.015], [0.015, 0.045]])
    shifted = Board.of("asymmetric_circles", 4, 5, 0.02, 0.015)
    np.testing.assert_allclose(shifted.points[[0, 1, 4], :2], [[0.01, 0.01], [0.05, 0.01], [0.03, 0.03]])
    np.testing.assert_allclose(shifted.size, [0.16, 0.1])
    assert (shifted.points[:, :2] < shifted.size).all()


@pytest.mark.parametrize(("kind", "x", "y"), [("circles", 4, 3), ("asymmetric_circles", 4, 6), ("chessboard", 5, 3)])
def test_what_is_ambiguous_looks_the_same_after_half_a_turn(kind: str, x: int, y: int) -> None:
    board = Board.model_validate(
        {"kind": kind, "squares_x": x, "squares_y": y, "square_length_m": 0.02, "marker_length_m": 0.015}
    )
    assert board.is_ambiguous
    np.testing.assert_allclose(
        board.points[::-1, :2], board.points[:, :2].min(0) + board.points[:, :2].max(0) - board.points[:, :2]
    )


def test_an_aprilgrid_has_kalibrs_tags_unless_it_says_otherwise() -> None:
    grid = Board.of("aprilgrid", 6, 6, 0.1144, 0.088)
    assert (grid.dictionary, grid.border_bits) == ("DICT_APRILTAG_36h11", 2)
    assert Board.model_validate({**grid.to_json(), "border_bits": 1}).border_bits == 1
    assert Board.of("tags", 2, 2, 0.1, 0.08).border_bits == 1


def test_chessboards_with_both_numbers_even_or_odd_are_ambiguous() -> None:
    found = [Board.of("chessboard", x, y, 0.03).is_ambiguous for x, y in ((9, 7), (8, 6), (8, 8), (9, 6))]
    assert found == [True, True, True, False] and not Board.of("charuco", 9, 7, 0.03, 0.02).is_ambiguous


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "charucco"}, "'charuco', 'chessboard', 'tags', 'aprilgrid', 'circles' or 'asymmetric_circles'"),
        ({"kind": "circles", "squares_x": 6}, "6x6 circles look the same after a quarter turn"),
        ({"kind": "chessboard", "squares_x": 7, "squares_y": 7}, "7x7 squares look the same after a quarter turn"),
        ({"kind": "asymmetric_circles", "marker_length_m": 0.05}, "smaller than 1.414 x square_length_m"),
        ({"squares_x": 2}, "2x6 squares are too few"),
        ({"squares_x": "many"}, "squares_x.*'many'"),
        ({"square_length_m": float("nan")}, "square_length_m"),
        ({"marker_length_m": 0.03}, "marker_length_m 0.03 must be above 0 and smaller"),
        ({"squares_z": 1}, "unknown key 'squares_z'.*did you mean 'squares_"),
    ],
)
def test_impossible_boards_are_refused_in_one_line(change: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message) as error:
        validate({**CHARUCO.model_dump(), **change}, Board, where="board.yaml")
    assert "\n" not in str(error.value)


def test_a_target_file_of_kalibr_is_read() -> None:
    """As Kalibr's own examples have it."""
    text = (
        "target_type: 'aprilgrid' #gridtype\ntagCols: 6\ntagRows: 5\ntagSize: 0.088 #[m]\ntagSpacing: 0.3 #share of tagSize\n"
        "codeOffset: 2\n"
    )
    grid = validate(yaml.safe_load(text), Board, where="april.yaml")
    assert grid == Board.of("aprilgrid", 6, 5, 0.1144, 0.088, first_id=2) and grid.border_bits == 2
    text = "target_type: 'checkerboard'\ntargetCols: 6\ntargetRows: 7\nrowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n"
    assert validate(yaml.safe_load(text), Board, where="checker.yaml") == Board.of("chessboard", 7, 8, 0.06)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"target_type": "circlegrid", "targetCols": 6}, "circlegrid.*marker_length_m"),
        ({"target_type": "apriltag"}, "'apriltag' of Kalibr is not read: possible are aprilgrid and checkerboard"),
        ({"target_type": ["aprilgrid"]}, "is not read"),
        ({"target_type": "aprilgrid", "tagCols": 6, "tagRows": 6, "tagSize": 0.088}, "needs a number for 'tagSpacing'"),
        (
            {"target_type": "checkerboard", "targetCols": 6, "targetRows": 7, "rowSpacingMeters": 0.06, "colSpacingMeters": 0.05},
            "squares must be square",
        ),
        (
            {"target_type": "aprilgrid", "tagCols": 2.5, "tagRows": 6, "tagSize": 0.088, "tagSpacing": 0.3},
            "tagCols and tagRows are whole numbers: 2.5 and 6",
        ),
    ],
)
def test_other_targets_of_kalibr_are_refused(content: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        validate(content, Board, where="target.yaml")
