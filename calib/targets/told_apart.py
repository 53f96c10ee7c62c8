"""Which targets may be in one picture: those whose markers differ."""

from collections.abc import Sequence
from itertools import combinations

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.targets.board import Board


def markers(board: Board) -> set[tuple[str, int]]:
    """Dictionary and number of every marker on a board; none on one without markers."""
    squares = board.squares_x * board.squares_y
    if not board.has_markers:
        return set()
    numbers = range(board.first_id, board.first_id + squares) if board.has_tags else range(squares // 2)
    return {(board.dictionary, number) for number in numbers}


def check_told_apart(boards: Sequence[Board], names: Sequence[object]) -> None:
    """Raise UsageError where two boards cannot be told apart in one picture."""
    for (one, name), (other, other_name) in combinations(zip(boards, names, strict=True), 2):
        shared = markers(one) & markers(other)
        if not (one.has_markers and other.has_markers):
            why, remedy = "one of them has no markers", "use targets with markers, ChArUco boards or tags"
        elif shared:
            dictionary, number = min(shared)
            why = f"both have marker {number} of {dictionary}"
            remedy = "print one with another dictionary, or tags with another --first-id, see 'calib board'"
        else:
            continue
        raise UsageError("two targets look alike", where=f"{name}, {other_name}", why=why, remedy=remedy)
