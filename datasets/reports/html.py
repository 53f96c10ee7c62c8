"""The reports of all commands: one self-contained HTML file, light and dark, for screen and paper.

    page = ReportPage("gold_head", made_by=["reconstruct report run --out report"])
    page.headline([("test PSNR", Number(26.99, "dB"))])
    page.section("Views", "Drag over a picture to compare.")
    page.wipes([("000", truth, rendered)])
    page.table(("view", "PSNR"), [("000", Number(27.3, "dB"))])
    page.write(Path("report.html"))

A click on a heading sorts its table. Of two pictures laid over each other, the pointer decides how much of each is visible; on
paper they stand side by side. The markup is in `templates/`, rendered by jinja2, which escapes all text.
"""

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from koala3d.datasets.core import files
from koala3d.datasets.imaging import images

Picture = NDArray[np.floating] | NDArray[np.uint8] | bytes
"""(height, width, 1 or 3) sRGB in 0..1 or as bytes, or the content of a PNG file."""


@dataclass(frozen=True)
class Number:
    """A value with its unit and, where it is known, its standard deviation in the same unit."""

    value: float | None
    unit: str = ""
    std: float | None = None
    digits: int | None = None  # digits after the point; None: two significant digits of the deviation, else four of the value

    @property
    def known(self) -> bool:
        """False where there is no finite value."""
        return self.value is not None and bool(np.isfinite(self.value))

    @property
    def text(self) -> str:
        """The value without its unit, as "2.222 ± 0.017"; a dash where it is not known."""
        if self.value is None or not np.isfinite(self.value):
            return "–"
        size = self.std if self.std else abs(self.value)
        digits = self.digits
        if digits is None:
            leading = int(np.floor(np.log10(size))) if size > 0 else 0
            digits = min(max((1 if self.std else 3) - leading, 0), 9)
        deviation = f" ± {self.std:.{digits}f}" if self.std else ""
        return f"{self.value:.{digits}f}{deviation}"


@dataclass(frozen=True)
class Link:
    """Words that lead to a file."""

    words: str
    path: str
    """Relative to the page."""

    @property
    def href(self) -> str:
        """The path as an address."""
        return quote(self.path)


@dataclass(frozen=True)
class Thumbnail:
    """A picture in a table, at its own size."""

    picture: Picture

    @cached_property
    def source(self) -> str:
        """The PNG file in base 64."""
        return _base64(self.picture)


Cell = str | int | Number | Thumbnail | tuple[Link, ...] | None


@cache
def _environment() -> Environment:
    loader = PackageLoader("koala3d.datasets", "reports/templates")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, keep_trailing_newline=True)


class ReportPage:
    """A page that is filled from top to bottom and then rendered or written."""

    def __init__(self, title: str, *, made_by: Sequence[str] = ()) -> None:
        """Begin a page.

        Args:
            made_by: the command lines that led to it; the last one made it.
        """
        self.title, self.made_by = title, tuple(made_by)
        self._head: list[str] = []
        self._body: list[str] = []
        self._blocks: Any = _environment().get_template("blocks.html").module

    def headline(self, figures: Iterable[tuple[str, Number]], words: str = "") -> None:
        """The result at a glance: a few named numbers, and a line beneath."""
        if figures := list(figures):
            self._head.append(self._blocks.headline(figures))
        if words:
            self._head.append(self._blocks.soft(words))

    def section(self, title: str, words: str = "") -> None:
        """Begin a section."""
        self._body.append(self._blocks.section(title, words))

    def heading(self, title: str) -> None:
        """A smaller heading inside a section."""
        self._body.append(self._blocks.heading(title))

    def paragraph(self, words: str) -> None:
        """A paragraph."""
        self._body.append(self._blocks.paragraph(words))

    def items(self, lines: Iterable[str]) -> None:
        """A list; the words "error:" and "warning:" at the beginning of a line are coloured."""
        self._body.append(self._blocks.items([_levelled(line) for line in lines]))

    def text(self, words: str) -> None:
        """Text with its own line breaks, as in a terminal."""
        self._body.append(self._blocks.text(words))

    def numbers(self, rows: Iterable[tuple[str, Number, str]]) -> None:
        """Named numbers with what each means, one per line."""
        self._body.append(self._blocks.numbers(list(rows)))

    def table(self, columns: Sequence[str], rows: Iterable[Sequence[Cell]]) -> None:
        """A sortable table. Columns of numbers are right-aligned, and their headings too."""
        cells = [tuple(row) for row in rows]
        numeric = [bool(cells) and all(isinstance(row[i], int | Number) for row in cells) for i in range(len(columns))]
        self._body.append(self._blocks.table(list(zip(columns, numeric, strict=True)), cells))

    def picture(self, picture: Picture, title: str, words: str = "") -> None:
        """One picture at its own size, or at the width of the page where that is less."""
        self._body.append(self._blocks.picture(_base64(picture), title, words))

    def pictures(self, named: Iterable[tuple[str, Picture]]) -> None:
        """Small pictures in rows, each with its name."""
        self._body.append(self._blocks.pictures([(name, _base64(picture)) for name, picture in named]))

    def wipes(
        self, pairs: Iterable[tuple[str, Picture | None, Picture]], names: tuple[str, str] = ("truth", "rendering")
    ) -> None:
        """A row of pairs of pictures laid over each other: the first is visible left of a line, the second right of it.

        Args:
            pairs: a name, and two pictures of one size; None where there is no first one.
            names: of the first and the second picture.
        """
        coded = [(name, None if first is None else _base64(first), _base64(second)) for name, first, second in pairs]
        self._body.append(self._blocks.wipes(coded, *names))

    def drawing(self, svg: str, words: str = "") -> None:
        """A drawing as SVG. It is not escaped: pass only drawings made by this program."""
        self._body.append(self._blocks.drawing(svg[svg.index("<svg") :], words))

    def render(self) -> str:
        """The page as text."""
        page = _environment().get_template("report.html")
        return page.render(title=self.title, head=self._head, body=self._body, made_by=self.made_by)

    def write(self, path: Path) -> None:
        """Write the page to a new file. Raises UsageError where something is there."""
        files.refuse_existing(path)
        files.write_text(path, self.render())


def _levelled(line: str) -> tuple[str, str]:
    """The level of a finding and the rest of its line; no level for any other line."""
    level, colon, rest = line.partition(":")
    return (level, rest) if colon and level in ("error", "warning") else ("", line)


def _base64(picture: Picture) -> str:
    return base64.b64encode(picture if isinstance(picture, bytes) else png_of(picture)).decode()


def png_of(picture: NDArray[np.floating] | NDArray[np.uint8]) -> bytes:
    """A (height, width, 1 or 3) sRGB picture, in 0..1 or as bytes, as the content of a PNG file."""
    import cv2

    pixels = picture if picture.dtype == np.uint8 else images.to_uint8(picture)
    coloured = np.broadcast_to(pixels, (*pixels.shape[:2], 3))
    done, data = cv2.imencode(".png", np.ascontiguousarray(coloured[..., ::-1]))
    assert done  # in memory: no disk can be full
    return data.tobytes()
