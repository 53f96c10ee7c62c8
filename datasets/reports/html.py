"""The reports of all commands: one HTML file with everything in it, light and dark, for the screen and for paper.

    page = ReportPage("gold_head", made_by=["reconstruct report run --out report"])
    page.headline([("test PSNR", Number(26.99, "dB"))])
    page.section("Views", "Drag over a picture to compare.")
    page.wipes([("000", truth, rendered)])
    page.table(("view", "PSNR"), [("000", Number(27.3, "dB"))])
    page.write(Path("report.html"))

Tables are sorted by a click on a heading; of two pictures laid over each other the pointer decides how much is seen of each, and
paper shows both. Whatever is given as text is escaped.
"""

import base64
import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files as package_files
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray

from datasets.core import files
from datasets.imaging import images

Picture = NDArray[np.floating] | NDArray[np.uint8] | bytes
"""(height, width, 1 or 3) sRGB in 0..1 or bytes, or the content of a PNG file."""


@dataclass(frozen=True)
class Number:
    """A value with its unit and, where it is known, its standard deviation in the same unit."""

    value: float | None
    unit: str = ""
    std: float | None = None
    digits: int | None = None
    """Digits after the point; None: two significant ones of the deviation, else four of the value."""

    @property
    def text(self) -> str:
        """The value without its unit, as "2.222 ± 0.017"; a dash where there is none."""
        if self.value is None or not np.isfinite(self.value):
            return "–"
        size = self.std if self.std else abs(self.value)
        digits = self.digits
        if digits is None:
            leading = int(np.floor(np.log10(size))) if size > 0 else 0
            digits = min(max((1 if self.std else 3) - leading, 0), 9)
        deviation = f" ± {self.std:.{digits}f}" if self.std else ""
        return f"{self.value:.{digits}f}{deviation}"


Cell = str | int | Number | None


class ReportPage:
    """A page that is filled from above to below and then rendered or written."""

    def __init__(self, title: str, *, made_by: Sequence[str] = ()) -> None:
        """Begin a page.

        Args:
            title: heading of the page, and of its window.
            made_by: command lines that lead to it, the last of which made it.
        """
        self.title, self.made_by = title, tuple(made_by)
        self._head: list[str] = []
        self._body: list[str] = []

    def headline(self, figures: Iterable[tuple[str, Number]], words: str = "") -> None:
        """The result at a glance: a few named numbers, and a line beneath."""
        shown = "".join(f"<div><b>{_number(number)}</b><span>{_text(name)}</span></div>" for name, number in figures)
        self._head.append(f'<div class="headline">{shown}</div>' if shown else "")
        self._head.append(f'<p class="soft">{_text(words)}</p>' if words else "")

    def section(self, title: str, words: str = "") -> None:
        """Begin a section."""
        self._body.append(f"<h2>{_text(title)}</h2>" + (f"<p>{_text(words)}</p>" if words else ""))

    def heading(self, title: str) -> None:
        """A smaller heading inside a section."""
        self._body.append(f"<h3>{_text(title)}</h3>")

    def paragraph(self, words: str) -> None:
        """A paragraph."""
        self._body.append(f"<p>{_text(words)}</p>")

    def items(self, lines: Iterable[str]) -> None:
        """A list; a line that begins with "error:" or "warning:" has its colour."""
        self._body.append(f"<ul>{''.join(f'<li>{_levelled(line)}</li>' for line in lines)}</ul>")

    def text(self, words: str) -> None:
        """Text with its own line breaks, as a terminal shows it."""
        self._body.append(f"<pre>{_text(words)}</pre>")

    def numbers(self, rows: Iterable[tuple[str, Number, str]]) -> None:
        """Named numbers with what each means, a line each."""
        lines = "".join(
            f'<tr><th>{_text(name)}</th><td class="number"><b>{number.text}</b></td><td>{_text(number.unit)}</td>'
            f'<td class="soft">{_text(meaning)}</td></tr>'
            for name, number, meaning in rows
        )
        self._body.append(f'<div class="scroll"><table><tbody>{lines}</tbody></table></div>')

    def table(self, columns: Sequence[str], rows: Iterable[Sequence[Cell]]) -> None:
        """A table that a click on a heading sorts; headings stand over their columns, numbers at the right."""
        cells = [tuple(row) for row in rows]
        right = [bool(cells) and all(isinstance(row[i], int | Number) for row in cells) for i in range(len(columns))]
        head = "".join(
            f"<th{' class=number' if at_right else ''}>{_text(column)}</th>"
            for column, at_right in zip(columns, right, strict=True)
        )
        body = "".join(f"<tr>{''.join(_cell(cell) for cell in row)}</tr>" for row in cells)
        self._body.append(
            f'<div class="scroll"><table class="sortable"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
        )

    def picture(self, picture: Picture, title: str, words: str = "") -> None:
        """One picture in its own size, or the width of the page where that is less."""
        caption = f"<figcaption>{_text(words)}</figcaption>" if words else ""
        self._body.append(f'<figure class="natural">{_image(picture, title)}{caption}</figure>')

    def pictures(self, named: Iterable[tuple[str, Picture]]) -> None:
        """Small pictures in rows, each with its name."""
        shown = "".join(
            f"<figure>{_image(picture, name)}<figcaption>{_text(name)}</figcaption></figure>" for name, picture in named
        )
        self._body.append(f'<div class="row">{shown}</div>')

    def wipes(
        self, pairs: Iterable[tuple[str, Picture | None, Picture]], names: tuple[str, str] = ("truth", "rendering")
    ) -> None:
        """A row of pairs laid over each other: left of the line the first is seen, right of it the second.

        Args:
            pairs: a name, and two pictures of one size; None: there is no first.
            names: of first and second.
        """
        shown = []
        for name, first, second in pairs:
            images_ = _image(second, f"{name}, {names[1]}")
            if first is not None:
                images_ = f'<div class="wipe">{_image(first, f"{name}, {names[0]}")}{images_}</div>'
            note = "" if first is not None else f" (no {names[0]})"
            shown.append(f"<figure>{images_}<figcaption>{_text(name + note)}</figcaption></figure>")
        self._body.append(f'<div class="row">{"".join(shown)}</div>')

    def drawing(self, svg: str, words: str = "") -> None:
        """A drawing as SVG, made here and not by a stranger: it is taken as it is."""
        self._body.append(f"<figure>{svg[svg.index('<svg') :]}<figcaption>{_text(words)}</figcaption></figure>")

    def render(self) -> str:
        """The page as text."""
        template = Template(package_files("datasets").joinpath("reports", "report.html").read_text(encoding="utf-8"))
        head, body = list(self._head), list(self._body)
        if self.made_by:
            head.append('<p><a href="#made-by">the command that made this page</a></p>')
            body.append(f'<h2 id="made-by">Made by</h2><pre>{_text(chr(10).join(self.made_by))}</pre>')
        return template.substitute(title=_text(self.title), head="\n".join(filter(None, head)), body="\n".join(body))

    def write(self, path: Path) -> None:
        """Write the page to a new file. Raises UsageError where something is there."""
        files.refuse_existing(path)
        files.write_text(path, self.render())


def _text(words: str) -> str:
    return html.escape(words)


def _levelled(line: str) -> str:
    level, colon, rest = line.partition(":")
    return f'<span class="{level}">{level}</span>:{_text(rest)}' if colon and level in ("error", "warning") else _text(line)


def _number(number: Number) -> str:
    return f"{number.text} {_text(number.unit)}".strip()


def _cell(cell: Cell) -> str:
    if isinstance(cell, Number):
        known = cell.value is not None and np.isfinite(cell.value)
        unit = f" <small>{_text(cell.unit)}</small>" if cell.unit and known else ""
        return f'<td class="number" data-value="{f"{cell.value:.9g}" if known else ""}">{cell.text}{unit}</td>'
    if isinstance(cell, int):
        return f'<td class="number" data-value="{cell}">{cell}</td>'
    return f"<td>{_text(cell or '')}</td>"


def _image(picture: Picture, alt: str) -> str:
    data = picture if isinstance(picture, bytes) else png_of(picture)
    return f'<img alt="{_text(alt)}" src="data:image/png;base64,{base64.b64encode(data).decode()}">'


def png_of(picture: NDArray[np.floating] | NDArray[np.uint8]) -> bytes:
    """The content of a PNG file of a (height, width, 1 or 3) sRGB picture in 0..1, or of bytes."""
    import cv2

    pixels = picture if picture.dtype == np.uint8 else images.to_uint8(picture)
    coloured = np.broadcast_to(pixels, (*pixels.shape[:2], 3))
    done, data = cv2.imencode(".png", np.ascontiguousarray(coloured[..., ::-1]))
    assert done  # of bytes in memory: there is no disk to be full
    return data.tobytes()
