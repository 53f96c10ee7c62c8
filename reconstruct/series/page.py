"""The page of a series: failures first, a row for each object, deviations, the ones that stand out; and its tables."""

import os
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from koala3d.datasets.core import files
from koala3d.datasets.core.console import command_line
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.formats import load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.reports.html import Cell, Link, Number, ReportPage, Thumbnail
from koala3d.reconstruct.series.table import (
    DEVIATIONS,
    FORMAT,
    INDEX,
    TABLE,
    VERSION,
    Row,
    csv_text,
    headings,
    said,
    standing_out,
)

PAGE, CSV = INDEX, "series.csv"
STRIP = "strip.png"
"""Picture beside a report: photograph, rendering, normals, depth, reflected part."""
HEIGHT = 56
"""Height of a row's picture [px]."""


def write(rows: Sequence[Row], scenes: Mapping[str, Path], out: Path, watched: Mapping[str, str]) -> None:
    """Write page and tables into `out`, each at once; they replace the former ones.

    Args:
        rows: objects in the order of the page.
        scenes: folder of each object's scene, which need not be there yet.
        watched: recordings that were found while the series ran, by name.
    """
    out_of_line = standing_out(rows)
    content = [{**row.content(), "stands_out": out_of_line.get(row.name, "")} for row in rows]
    files.write_json(out / TABLE, {"format": FORMAT, "version": VERSION, "watched": dict(watched), "objects": content})
    files.write_text(out / CSV, csv_text(rows))
    files.write_text(out / PAGE, _html(rows, scenes, out, out_of_line))


def _html(rows: Sequence[Row], scenes: Mapping[str, Path], out: Path, out_of_line: Mapping[str, str]) -> str:
    """The page as text."""
    page = ReportPage(f"{out.name}: {len(rows)} objects", made_by=[command_line()])
    counts = {state: sum(row.state == state for row in rows) for state in ("done", "running", "waiting", "failed")}
    shown = [(state, Number(float(count), digits=0)) for state, count in counts.items() if count or state == "done"]
    page.headline([*shown, ("of work", Number(sum(sum(row.seconds.values()) for row in rows) / 3600, "h", digits=2))])
    if failed := [row for row in rows if row.state == "failed"]:
        page.section("Failures", "The same command runs what has failed again and keeps what is done.")
        page.items(f"error: {row.name}, {row.step}: {row.error}" for row in failed)
    if out_of_line:
        page.section("Objects that stand out")
        page.items(f"warning: {name}: {why}" for name, why in out_of_line.items())
    page.section(
        "Objects", "Reload the page to see how far they are. Pictures: photograph, rendering, normals, depth, reflected part."
    )
    figures = {key: words for key, words in headings(rows).items() if key not in DEVIATIONS}
    body = [_cells(row, scenes[row.name], out, figures, failed=bool(failed)) for row in rows]
    page.table(("", "object", "state", "time [s]", *figures.values(), "files", *(["error"] if failed else [])), body)
    if compared := {key: words for key, words in headings(rows).items() if key in DEVIATIONS}:
        _deviations(page, [row for row in rows if compared.keys() & row.figures.keys()], compared)
    kinds = list(dict.fromkeys(kind for row in rows for kind in row.seconds))
    if kinds:
        page.section("Time of each step [s]")
        times = [(row.name, *(Number(row.seconds.get(kind), digits=1) for kind in kinds)) for row in rows]
        page.table(("object", *kinds), times)
    return page.render()


def _cells(row: Row, scene: Path, out: Path, figures: Mapping[str, str], *, failed: bool) -> list[Cell]:
    """An object's line of the table, with a column of errors if any object has failed."""
    links = [Link(what, os.path.relpath(path, out)) for what, path in row.files.items()]
    if row.state == "failed":
        links.append(Link("log", f"{row.name}/steps/{row.step}.log"))
    state = f"{row.state}: {row.step}" if row.step else row.state
    numbers = [Number(row.figures.get(key)) for key in figures]
    seconds, error = Number(sum(row.seconds.values()), digits=0), [row.error] if failed else []
    return [_picture(row, scene), row.name, state, seconds, *numbers, tuple(links), *error]


def _deviations(page: ReportPage, rows: Sequence[Row], columns: Mapping[str, str]) -> None:
    """How the shapes deviate."""
    words = "Outward positive. Significant: beyond what its uncertainty explains. The mean piece is in the folder 'mean'."
    page.section("Deviations of shape", words)
    shown = {key: heading for key, heading in columns.items() if not key.endswith("_std")}
    number = lambda row, key: Number(row.figures.get(key), std=row.figures.get(f"{key}_std"))  # noqa: E731
    lines = [(row.name, row.compared_with, *(number(row, key) for key in shown)) for row in rows]
    page.table(("object", "compared with", *shown.values()), lines)
    if any(row.places for row in rows):
        page.heading("Where they deviate most")
        page.items(f"{row.name}: {'; '.join(said(place) for place in row.places)}" for row in rows if row.places)


def _picture(row: Row, scene: Path) -> Thumbnail | None:
    """The strip of the report; before that, a photograph; None where there is neither."""
    report = row.files.get("report")
    strip = None if report is None else report.with_name(STRIP)
    try:
        if strip is not None and strip.is_file():
            return _small(strip)
        return _photograph(scene) if scene.is_dir() else None
    except (KoalaError, OSError):
        return None


@cache
def _small(path: Path) -> Thumbnail:
    """A picture file, made small."""
    picture = images.read(path)
    return Thumbnail(images.resize(picture, max(1, round(HEIGHT * picture.shape[1] / picture.shape[0])), HEIGHT))


@cache
def _photograph(scene: Path) -> Thumbnail:
    """The first view of a scene, made small."""
    return Thumbnail(load_scene(scene).views[0].read_small(HEIGHT)[..., :3])
