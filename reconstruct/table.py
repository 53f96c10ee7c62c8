"""Tables over many runs in the layout of the paper's: a block per scene, a row per model, the best of each column bold.

Text is Markdown, CSV or LaTeX. The figures come from each run's `metrics.json`; what they mean stands under the table.
"""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datasets import files
from datasets.errors import DatasetError, Misuse, nearest
from reconstruct import metrics, surface_distance
from reconstruct.evaluate import FORMAT, METRICS, VERSION
from reconstruct.run import Run
from reconstruct.words import mesh_without, unit

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


@dataclass(frozen=True)
class Row:
    """One line: where it belongs, what it is called, its figures by name."""

    scene: str
    label: str
    values: dict[str, float | None]
    stands_on: str | None = None
    """Side through which alone the measured mesh may leave the box; None where nothing was left out."""


def rows_of_runs(runs: Sequence[Path], *, per_image: bool = False) -> list[Row]:
    """A row per run, or one per image of each run; in the order of the runs, blocks of one scene together.

    Raises:
        Misuse: one of them is no run, or was not measured yet.
    """
    rows, labels = [], set()
    for path in runs:
        run = Run.open(path)
        if not (run.path / METRICS).is_file():
            raise Misuse("was not measured yet", where=run.path, remedy=f"run: reconstruct eval {run.path}")
        result = files.read_json(run.path / METRICS, kind=FORMAT, version=VERSION)
        scene, label = run.content.get("scene_name", Path(run.scene_path).name), run.config.model
        label += ", fine-tuned" if "from" in run.content else ""
        while (scene, label) in labels:  # two runs of one model are told apart by their folders
            label = f"{label} ({run.path.name})" if "(" not in label else f"{label}'"
        labels.add((scene, label))
        try:
            if per_image:
                rows += [Row(f"{scene}, {label}", view["name"], view) for view in result["per_view"]]
            else:
                values = {**result["mean"], **(result.get("mesh") or {})}
                rows.append(Row(scene, label, values, result.get("mesh_stands_on")))
        except (KeyError, TypeError) as error:
            raise DatasetError("metrics are not complete", where=run.path / METRICS, why=str(error)) from None
    order = list(dict.fromkeys(row.scene for row in rows))
    return sorted(rows, key=lambda row: order.index(row.scene))


def chosen_columns(rows: Sequence[Row], wanted: Sequence[str] = ()) -> list[str]:
    """The wanted columns, or `COLUMNS`; without those that no row has a value for.

    Raises:
        Misuse: there is no figure of a wanted name.
    """
    for name in wanted:
        if name not in HEADINGS:
            raise Misuse(f"there is no figure '{name}'", where="--columns", remedy=nearest(name, HEADINGS))
    return [name for name in (wanted or COLUMNS) if any(row.values.get(name) is not None for row in rows)]


def best(rows: Sequence[Row], column: str) -> float | None:
    """The best value of a column, None where there are fewer than two to compare."""
    values = [value for row in rows if (value := row.values.get(column)) is not None]
    if len(values) < 2:
        return None
    return max(values) if column in HIGHER_IS_BETTER else min(values)


def shown(value: float | None, column: str) -> str:
    """A figure with the digits that the paper gives it."""
    if value is None:
        return "–"
    return f"{value:.3f}" if column in ("ssim", "lpips", "disparity_rmse", "f_score", "seconds") else f"{value:.2f}"


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
            lines.append(" & ".join([first, _escaped(row.label), *cells]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def csv_text(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """Comma-separated values, all digits; the header has the figures' names."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["scene", "model", *columns])
    for row in rows:
        writer.writerow([row.scene, row.label, *("" if row.values.get(c) is None else row.values[c] for c in columns)])
    return buffer.getvalue()


FORMS: dict[str, Callable[[Sequence[Row], Sequence[str]], str]] = {".md": markdown, ".csv": csv_text, ".tex": latex}
"""Writer by the suffix of the file."""


def write(rows: Sequence[Row], columns: Sequence[str], out: Path) -> None:
    """Write a table in the form that the suffix of `out` names.

    Raises:
        Misuse: no form has that suffix, or `out` exists.
    """
    if out.suffix not in FORMS:
        raise Misuse(f"tables are not written as '{out.suffix}'", where=out, remedy=f"end --out in {', '.join(FORMS)}")
    files.refuse_existing(out)
    files.write_text(out, FORMS[out.suffix](rows, columns))


def notes(rows: Sequence[Row], columns: Sequence[str]) -> list[str]:
    """What the columns mean, a line each, and which rows' meshes were measured in part."""
    lines = [f"{HEADINGS[column]}: {definition(column)}" for column in columns]
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
    values: list[tuple[str, Any]] = [(column, row.values.get(column)) for column in columns]
    return [
        bold(shown(value, column)) if value is not None and value == best(block, column) else shown(value, column)
        for column, value in values
    ]


def _escaped(text: str) -> str:
    for plain, escaped in {"_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#", "×": r"$\times$"}.items():
        text = text.replace(plain, escaped)
    return text
