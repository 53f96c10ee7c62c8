"""Boards to print, in true size, as SVG or PDF.

Everything dark is a rectangle: squares, and the cells of markers. A bar of 100 mm below the board shows whether the printer
has scaled the page.
"""

from pathlib import Path

import numpy as np

from calib.arrays import Array, Mask
from calib.targets.detection import dictionary_of
from datasets.board import Board
from datasets.core import files
from datasets.core.errors import UsageError

MARGIN_MM = 10.0
FOOTER_MM = 14.0
POINTS_PER_MM = 72 / 25.4


def dark_rectangles(board: Board) -> Array:
    """(n, 4) x, y, width, height [m] in the board frame of everything that is printed black."""
    side, found = board.square_length_m, []
    if board.kind != "tags":
        found += [(x * side, y * side, side, side) for x, y in _squares(board) if _is_dark(board, x, y)]
    if board.kind != "chessboard":
        margin = (side - board.marker_length_m) / 2
        for number, (x, y) in enumerate(_marker_squares(board)):
            cells = _marker(board, board.first_id + number if board.kind == "tags" else number)
            found += _cells(cells, x * side + margin, y * side + margin, board.marker_length_m / len(cells))
    return np.array(found)


def _squares(board: Board) -> list[tuple[int, int]]:
    """(column, row) of all squares, row by row."""
    return [(x, y) for y in range(board.squares_y) for x in range(board.squares_x)]


def _is_dark(board: Board, x: int, y: int) -> bool:
    return (x + y + (board.squares_y % 2 == 0 and board.kind == "charuco" and board.legacy_pattern)) % 2 == 0


def _marker_squares(board: Board) -> list[tuple[int, int]]:
    """(column, row) of the squares that hold markers, in the order of their numbers."""
    return [(x, y) for x, y in _squares(board) if board.kind == "tags" or not _is_dark(board, x, y)]


def _marker(board: Board, number: int) -> Mask:
    """(cells, cells) true where a marker is dark, its border included."""
    dictionary = dictionary_of(board)
    cells = dictionary.markerSize + 2
    return dictionary.generateImageMarker(number, cells, borderBits=1) < 128


def _cells(dark: Mask, left: float, top: float, size: float) -> list[tuple[float, float, float, float]]:
    """Runs of dark cells in a row as one rectangle each: seams between cells could print as hairlines."""
    found = []
    for row, line in enumerate(dark):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(int), [0]])))
        found += [(left + a * size, top + row * size, (b - a) * size, size) for a, b in edges.reshape(-1, 2)]
    return found


def write(board: Board, path: Path) -> None:
    """Write a board as PDF or SVG, by the suffix of `path`. Raises UsageError where it is neither, or exists."""
    path = Path(path)
    writers = {".svg": _svg, ".pdf": _pdf}
    if path.suffix.lower() not in writers:
        raise UsageError("boards are written as .pdf or .svg", where=path, why=f"suffix {path.suffix!r}")
    files.refuse_existing(path)
    files.write_bytes(path, writers[path.suffix.lower()](board))


def page_mm(board: Board) -> tuple[float, float]:
    """Width and height of the page [mm]."""
    width, height = 1e3 * board.square_length_m * np.array([board.squares_x, board.squares_y])
    return max(float(width), 100.0) + 2 * MARGIN_MM, float(height) + 2 * MARGIN_MM + FOOTER_MM


def _label(board: Board) -> str:
    marker = f", markers {1e3 * board.marker_length_m:g} mm {board.dictionary}" if board.kind != "chessboard" else ""
    first = f" from {board.first_id}" if board.kind == "tags" else ""
    squares = f"{board.squares_x}x{board.squares_y}, squares {1e3 * board.square_length_m:g} mm"
    return f"{board.kind} {squares}{marker}{first}; bar: 100 mm"


def _placed(board: Board) -> Array:
    """(n, 4) rectangles on the page [mm], the bar last."""
    rectangles = 1e3 * dark_rectangles(board) + [MARGIN_MM, MARGIN_MM, 0, 0]
    return np.vstack([rectangles, [MARGIN_MM, page_mm(board)[1] - MARGIN_MM - 5, 100.0, 1.0]])


def _svg(board: Board) -> bytes:
    width, height = page_mm(board)
    size = f'width="{width:.4f}mm" height="{height:.4f}mm" viewBox="0 0 {width:.4f} {height:.4f}"'
    place = f'x="{MARGIN_MM}" y="{height - MARGIN_MM:.4f}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
        '<rect width="100%" height="100%" fill="white"/>',
        *(f'<rect x="{x:.4f}" y="{y:.4f}" width="{w:.4f}" height="{h:.4f}"/>' for x, y, w, h in _placed(board)),
        f'<text {place} font-family="sans-serif" font-size="3.5">{_label(board)}</text>\n</svg>\n',
    ]
    return "\n".join(lines).encode()


def _pdf(board: Board) -> bytes:
    """One page with filled rectangles (ISO 32000-1, 8.5.2); y runs upwards there."""
    width, height = page_mm(board)
    k = POINTS_PER_MM
    lines = [f"{x * k:.4f} {(height - y - h) * k:.4f} {w * k:.4f} {h * k:.4f} re" for x, y, w, h in _placed(board)]
    label = f"BT /F 9 Tf {MARGIN_MM * k:.2f} {(MARGIN_MM - 1) * k:.2f} Td ({_label(board)}) Tj ET"
    content = "\n".join(["0 g", *lines, "f", label])
    objects = [
        "<< /Type /Catalog /Pages 2 0 R >>",
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width * k:.4f} {height * k:.4f}] /Contents 4 0 R "
        "/Resources << /Font << /F << /Type /Font /Subtype /Type1 /BaseFont /Helvetica >> >> >> >>",
        f"<< /Length {len(content)} >>\nstream\n{content}\nendstream",
    ]
    data, places = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, 1):
        places.append(len(data))
        data += f"{number} 0 obj\n{body}\nendobj\n".encode()
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    size = len(objects) + 1
    trailer = f"trailer << /Size {size} /Root 1 0 R >>\nstartxref\n{len(data)}\n%%EOF\n"
    return data + f"xref\n0 {size}\n0000000000 65535 f \n{table}{trailer}".encode()
