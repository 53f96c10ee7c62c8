"""Tables over many runs in the layout of the paper's: a block per scene, a row per model, the best of each column bold.

Text is Markdown, CSV or LaTeX; what the figures mean stands under the table.
"""

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path

from datasets.core import files
from datasets.core.errors import UsageError, nearest
from reconstruct.output import metrics, surface_distance
from reconstruct.output.words import mesh_without, unit
from reconstruct.studies.results import Row

COLUMNS = ("psnr", "ssim", "lpips", "normal_mae_alpha_acc_deg", "normal_mae_deg", "disparity_rmse")
"""Shown where nothing else is asked for, as far as it was measured: the paper's, with the normal error in both of its definitions."""
HEADINGS = {
    "psnr": "PSNR", "ssim": "SSIM", "lpips": "LPIPS", "normal_mae_alpha_acc_deg": "MAE (alpha × opacity)", "normal_mae_deg": "MAE (alpha)",
    "normal_pred_mae_alpha_acc_deg": "predicted MAE (alpha × opacity)", "normal_pred_mae_deg": "predicted MAE (alpha)",
    "disparity_rmse": "RMSE", "depth_rmse_mm": "depth RMSE", "depth_median_mm": "depth median", "diffuse_psnr": "diffuse PSNR",
    "specular_psnr": "specular PSNR", "seconds": "time per view", "chamfer_mm": "Chamfer", "accuracy_mm": "accuracy",
    "completeness_mm": "completeness", "f_score": "F-score", "threshold_mm": "F-score threshold",
}  # fmt: skip
"""What columns are called; units are added."""
HIGHER_IS_BETTER = {"psnr", "ssim", "diffuse_psnr", "specular_psnr", "f_score"}


def chosen_columns(rows: Sequence[Row], wanted: Sequence[str] = ()) -> list[str]:
    """The wanted columns, or `COLUMNS`; without those that no row has a value for.

    Raises:
        UsageError: there is no figure of a wanted name.
    """
    for name in wanted:
        if name not in HEADINGS:
            raise UsageError(f"there is no figure '{name}'", where="--columns", remedy=nearest(name, HEADINGS))
    return [name for name in (wanted or COLUMNS) if any(row.values.get(name) is not None for row in rows)]


def best(rows: Sequence[Row], column: str) -> float | None:
    """The best value of a column, None where there are fewer than two to compare."""
    values = [value for row in rows if (value := row.values.get(column)) is not None]
    if len(values) < 2:
        return None
    return max(values) if column in HIGHER_IS_BETTER else min(values)


def shown(row: Row, column: str) -> str:
    """A figure with the digits that the paper gives it, ± its standard deviation over seeds."""
    value = row.values.get(column)
    if value is None:
        return "–"
    digits = 3 if column in ("ssim", "lpips", "disparity_rmse", "f_score", "seconds") else 2
    return f"{value:.{digits}f}" + (f" ± {row.deviations[column]:.{digits}f}" if column in row.deviations else "")


def heading(column: str) -> str:
    """Name and unit of a column."""
    return f"{HEADINGS[column]} [{unit(column)}]" if unit(column) else HEADINGS[column]


def markdown(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """A Markdown table, with the definitions of its columns under it."""
    lines = ["| scene | model | " + " | ".join(heading(c) for c in columns) + " |", "|---|---|" + "---:|" * len(columns)]
    for block in _blocks(rows):
        for index, row in enumerate(block):
            cells = _cells(row, block, columns, lambda text: f"**{text}**")
            lines.append(f"| {row.scene if index == 0 else ''} | {row.label} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", *(f"* {note}" for note in notes(rows, columns))]) + "\n"


def latex(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """A LaTeX tabular in the paper's layout (booktabs and multirow), with the definitions as comments."""
    lines = [f"% {note}" for note in notes(rows, columns)]
    lines += [r"\begin{tabular}{ll" + "r" * len(columns) + "}", r"\toprule"]
    lines.append(" & ".join(["", "Model", *(_escaped(heading(c)) for c in columns)]) + r" \\")
    for block in _blocks(rows):
        lines.append(r"\midrule")
        for index, row in enumerate(block):
            cells = _cells(row, block, columns, lambda text: rf"\textbf{{{text}}}")
            first = rf"\multirow{{{len(block)}}}{{*}}{{{_escaped(row.scene)}}}" if index == 0 else ""
            lines.append(" & ".join([first, _escaped(row.label), *map(_escaped, cells)]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def csv_text(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """Comma-separated values, all digits; the header has the figures' names, NAME_std their standard deviations over seeds."""
    contents = [{"scene": row.scene, "model": row.label, **row.content(columns)} for row in rows]
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, ["scene", "model", *_fields(rows, columns)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(contents)
    return buffer.getvalue()


def _fields(rows: Sequence[Row], columns: Sequence[str]) -> list[str]:
    several = max((row.seeds for row in rows), default=1) > 1
    return [name for column in columns for name in ((column, f"{column}_std") if several else (column,))] + ["seeds"] * several


FORMS: dict[str, Callable[[Sequence[Row], Sequence[str]], str]] = {".md": markdown, ".csv": csv_text, ".tex": latex}
"""Writer by the suffix of the file."""


def write(rows: Sequence[Row], columns: Sequence[str], out: Path) -> None:
    """Write a table in the form that the suffix of `out` names.

    Raises:
        UsageError: no form has that suffix, or `out` exists.
    """
    if out.suffix not in FORMS:
        raise UsageError(f"tables are not written as '{out.suffix}'", where=out, remedy=f"end --out in {', '.join(FORMS)}")
    files.refuse_existing(out)
    files.write_text(out, FORMS[out.suffix](rows, columns))


def write_all(rows: Sequence[Row], columns: Sequence[str], folder: Path) -> None:
    """Write a table in every form, as `folder`/table.*; earlier ones are replaced, since such a folder grows."""
    for suffix, form in FORMS.items():
        files.write_text(folder / f"table{suffix}", form(rows, columns))


def notes(rows: Sequence[Row], columns: Sequence[str]) -> list[str]:
    """What the columns mean, a line each, and which rows' meshes were measured in part."""
    lines = [f"{HEADINGS[column]}: {definition(column)}" for column in columns]
    seeds = sorted({row.seeds for row in rows})
    if seeds and seeds[-1] > 1:
        lines.append(f"mean ± standard deviation over {' to '.join(map(str, dict.fromkeys((seeds[0], seeds[-1]))))} seeds")
    if not any(column in surface_distance.DEFINITIONS for column in columns):
        return lines
    return lines + [f"{row.scene}, {row.label}: {mesh_without(row.stands_on)}" for row in rows if row.stands_on is not None]


def definition(column: str) -> str:
    """What a figure means."""
    return metrics.DEFINITIONS[column][1] if column in metrics.DEFINITIONS else surface_distance.DEFINITIONS[column]


def _blocks(rows: Sequence[Row]) -> list[list[Row]]:
    return [[row for row in rows if row.scene == scene] for scene in dict.fromkeys(row.scene for row in rows)]


def _cells(row: Row, block: list[Row], columns: Sequence[str], bold: Callable[[str], str]) -> list[str]:
    """Figures of a row as text, the best of its block bold."""
    leads = lambda column: (value := row.values.get(column)) is not None and value == best(block, column)  # noqa: E731
    return [bold(shown(row, column)) if leads(column) else shown(row, column) for column in columns]


def _escaped(text: str) -> str:
    for plain, escaped in {"_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#", "×": r"$\times$", "±": r"$\pm$"}.items():
        text = text.replace(plain, escaped)
    return text
