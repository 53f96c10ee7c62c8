"""Boards to print, in true size, as SVG or PDF.

Everything dark is a rectangle or a circle. A bar of 100 mm below the board shows whether the printer has scaled the page.
"""

from pathlib import Path

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.targets.board import Board
from koala3d.datasets.targets.pattern import Pattern

MARGIN_MM = 10.0
FOOTER_MM = 14.0
POINTS_PER_MM = 72 / 25.4


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
    width, height = 1e3 * (board.size + 2 * Pattern(board).overhang)
    return max(float(width), 100.0) + 2 * MARGIN_MM, float(height) + 2 * MARGIN_MM + FOOTER_MM


def _label(board: Board) -> str:
    marker = f", markers {1e3 * board.marker_length_m:g} mm {board.dictionary}" if board.has_markers else ""
    marker = f", circles {1e3 * board.marker_length_m:g} mm" if board.has_circles else marker
    first = f" from {board.first_id}" if board.has_tags else ""
    squares = f"{board.squares_x}x{board.squares_y}, squares {1e3 * board.square_length_m:g} mm"
    return f"{board.kind} {squares}{marker}{first}; bar: 100 mm"


def origin_mm(board: Board) -> float:
    """Distance of the board's first corner from the left and the upper edge of the page [mm]."""
    return MARGIN_MM + 1e3 * Pattern(board).overhang


def _rectangles(board: Board) -> Array:
    """(n, 4) rectangles on the page [mm], the bar last."""
    rectangles = 1e3 * Pattern(board).rectangles + [origin_mm(board), origin_mm(board), 0, 0]
    return np.vstack([rectangles, [MARGIN_MM, page_mm(board)[1] - MARGIN_MM - 5, 100.0, 1.0]])


def _circles(board: Board) -> Array:
    """(n, 3) middles and radii on the page [mm]."""
    return 1e3 * Pattern(board).circles * [1, 1, 0.5] + [origin_mm(board), origin_mm(board), 0]


def _svg(board: Board) -> bytes:
    width, height = page_mm(board)
    size = f'width="{width:.4f}mm" height="{height:.4f}mm" viewBox="0 0 {width:.4f} {height:.4f}"'
    place = f'x="{MARGIN_MM}" y="{height - MARGIN_MM:.4f}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
        '<rect width="100%" height="100%" fill="white"/>',
        *(f'<rect x="{x:.4f}" y="{y:.4f}" width="{w:.4f}" height="{h:.4f}"/>' for x, y, w, h in _rectangles(board)),
        *(f'<circle cx="{x:.4f}" cy="{y:.4f}" r="{r:.4f}"/>' for x, y, r in _circles(board)),
        f'<text {place} font-family="sans-serif" font-size="3.5">{_label(board)}</text>\n</svg>\n',
    ]
    return "\n".join(lines).encode()


def _pdf(board: Board) -> bytes:
    """One page with filled rectangles and circles (ISO 32000-1, 8.5.2); y runs upwards there."""
    width, height = page_mm(board)
    k = POINTS_PER_MM
    lines = [f"{x * k:.4f} {(height - y - h) * k:.4f} {w * k:.4f} {h * k:.4f} re" for x, y, w, h in _rectangles(board)]
    lines += [_pdf_circle(x * k, (height - y) * k, r * k) for x, y, r in _circles(board)]
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


def _pdf_circle(x: float, y: float, r: float) -> str:
    """The path of a circle: four Bezier curves, which deviate from it by at most 0.03 % of the radius."""
    bow = 4 / 3 * (np.sqrt(2) - 1) * r
    curves = [
        (x + r, y + bow, x + bow, y + r, x, y + r),
        (x - bow, y + r, x - r, y + bow, x - r, y),
        (x - r, y - bow, x - bow, y - r, x, y - r),
        (x + bow, y - r, x + r, y - bow, x + r, y),
    ]
    drawn = [" ".join(f"{number:.4f}" for number in curve) + " c" for curve in curves]
    return "\n".join([f"{x + r:.4f} {y:.4f} m", *drawn, "h"])
