"""Tables of many runs in the paper's layout: a block per scene, a row per model, the best of each column bold.

Formats are Markdown, CSV and LaTeX. Markdown and LaTeX include the definitions of the columns.
"""

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.reconstruct.experiments.results import Row
from koala3d.reconstruct.output.mesh import surface_distance
from koala3d.reconstruct.output.metric_names import HIGHER_IS_BETTER, SHORT_NAMES, column_heading, definition, mesh_note

COLUMNS = ("psnr", "ssim", "psnr_inside", "ssim_inside", "lpips", "normal_mae_alpha_acc_deg", "normal_mae_deg", "disparity_rmse")
"""Default columns: the paper's, with the normal error in both of its definitions, and pictures also inside the mask."""


def chosen_columns(rows: Sequence[Row], wanted: Sequence[str] = ()) -> list[str]:
    """The wanted columns, or `COLUMNS`, less those without any value. Raises UsageError: a wanted column is unknown."""
    for name in wanted:
        if name not in SHORT_NAMES:
            raise UsageError(f"there is no metric '{name}'", where="--column", remedy=nearest(name, SHORT_NAMES))
    return [name for name in (wanted or COLUMNS) if any(row.values.get(name) is not None for row in rows)]


def best(rows: Sequence[Row], column: str) -> float | None:
    """The best value of a column; None for fewer than two values."""
    values = [value for row in rows if (value := row.values.get(column)) is not None]
    if len(values) < 2:
        return None
    return max(values) if column in HIGHER_IS_BETTER else min(values)


def shown(row: Row, column: str) -> str:
    """A value with as many digits as in the paper, ± its standard deviation over seeds."""
    value = row.values.get(column)
    if value is None:
        return "–"
    digits = 3 if column in ("ssim", "ssim_inside", "lpips", "disparity_rmse", "f_score", "seconds") else 2
    return f"{value:.{digits}f}" + (f" ± {row.deviations[column]:.{digits}f}" if column in row.deviations else "")


def markdown(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """A Markdown table, followed by the definitions of its columns."""
    lines = ["| scene | model | " + " | ".join(column_heading(c) for c in columns) + " |", "|---|---|" + "---:|" * len(columns)]
    for block in _blocks(rows):
        for index, row in enumerate(block):
            cells = _cells(row, block, columns, lambda text: f"**{text}**")
            lines.append(f"| {row.scene if index == 0 else ''} | {row.label} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", *(f"* {note}" for note in notes(rows, columns))]) + "\n"


def latex(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """A LaTeX tabular in the paper's layout (booktabs and multirow), with the definitions as comments."""
    lines = [f"% {note}" for note in notes(rows, columns)]
    lines += [r"\begin{tabular}{ll" + "r" * len(columns) + "}", r"\toprule"]
    lines.append(" & ".join(["", "Model", *(_escaped(column_heading(c)) for c in columns)]) + r" \\")
    for block in _blocks(rows):
        lines.append(r"\midrule")
        for index, row in enumerate(block):
            cells = _cells(row, block, columns, lambda text: rf"\textbf{{{text}}}")
            first = rf"\multirow{{{len(block)}}}{{*}}{{{_escaped(row.scene)}}}" if index == 0 else ""
            lines.append(" & ".join([first, _escaped(row.label), *map(_escaped, cells)]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def csv_text(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """Comma-separated values with all digits; column NAME_std holds the standard deviation over seeds."""
    contents = [{"scene": row.scene, "model": row.label, **row.content(columns)} for row in rows]
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, ["scene", "model", *_fields(rows, columns)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(contents)
    return buffer.getvalue()


def _fields(rows: Sequence[Row], columns: Sequence[str]) -> list[str]:
    several = max((row.seeds for row in rows), default=1) > 1
    return [name for column in columns for name in ((column, f"{column}_std") if several else (column,))] + ["seeds"] * several


FORMATS: dict[str, Callable[[Sequence[Row], Sequence[str]], str]] = {".md": markdown, ".csv": csv_text, ".tex": latex}
"""Writer by the file's suffix."""


def refuse_other(out: Path, suffixes: Sequence[str]) -> None:
    """Raise UsageError where a file exists, or its name has none of the suffixes."""
    if out.suffix not in suffixes:
        raise UsageError(f"tables are not written as '{out.suffix}'", where=out, remedy=f"end --out in {', '.join(suffixes)}")
    files.refuse_existing(out)


def notes(rows: Sequence[Row], columns: Sequence[str]) -> list[str]:
    """Definitions of the columns, a line each; how meshes were cut where that was asked for."""
    lines = [f"{SHORT_NAMES[column]}: {definition(column)}" for column in columns]
    seeds = sorted({row.seeds for row in rows})
    if seeds and seeds[-1] > 1:
        lines.append(f"mean ± standard deviation over {' to '.join(map(str, dict.fromkeys((seeds[0], seeds[-1]))))} seeds")
    if not any(column in surface_distance.DEFINITIONS for column in columns):
        return lines
    return lines + [f"{row.scene}, {row.label}: {mesh_note(row.stands_on)}" for row in rows if row.stands_on is not None]


def _blocks(rows: Sequence[Row]) -> list[list[Row]]:
    return [[row for row in rows if row.scene == scene] for scene in dict.fromkeys(row.scene for row in rows)]


def _cells(row: Row, block: list[Row], columns: Sequence[str], bold: Callable[[str], str]) -> list[str]:
    """Values of a row as text, the best of its block bold."""
    leads = lambda column: (value := row.values.get(column)) is not None and value == best(block, column)  # noqa: E731
    return [bold(shown(row, column)) if leads(column) else shown(row, column) for column in columns]


def _escaped(text: str) -> str:
    for plain, escaped in {"_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#", "×": r"$\times$", "±": r"$\pm$"}.items():
        text = text.replace(plain, escaped)
    return text
