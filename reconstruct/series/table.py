"""What is known of each object: state, time, figures, files, and how its shape deviates; the ones that stand out."""

import csv
import io
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files
from koala3d.reconstruct.output.metric_names import column_heading
from koala3d.reconstruct.series.plan import ASSET, COMPARE, MESH, REPORT, Piece

FORMAT, VERSION, TABLE = "koala-series-table", 1, "series.json"
SHAPE, INDEX = "shape.json", "index.html"
FIGURES = ("psnr", "ssim", "normal_mae_alpha_acc_deg", "chamfer_mm")
DEVIATIONS = {
    "deviation_mean_mm": "mean deviation [mm]",
    "deviation_rms_mm": "RMS [mm]",
    "deviation_p95_mm": "95 % below [mm]",
    "within": "within tolerance [%]",
    "significant": "significant [%]",
    "from_mean_mm": "from the mean piece, RMS [mm]",
    "scale": "scale",
    "scale_std": "its standard deviation",
}
"""Heading of each figure of a comparison."""
SHOWN = 3
"""Places of an object in the table."""
MOST_SIGNIFICANT = 1.0
"""Share of a surface that may deviate significantly before the piece stands out [%]."""
MOST_UNLIKE = 3.0
"""Multiple of the other pieces' median distance from the mean piece from which on a piece stands out."""


@dataclass(frozen=True)
class Row:
    """An object as the page shows it."""

    name: str
    state: str  # failed, running, waiting or done
    step: str  # the step that it is at, or that failed; "" if it is done
    error: str
    seconds: dict[str, float]  # of its finished steps
    figures: dict[str, float]
    files: dict[str, Path]  # what is there, by what it is
    compared_with: str  # object or drawing that its shape is compared with; "" for none
    mean: str  # name of the mean piece of its kind; "" for none
    places: list[dict[str, Any]]  # where it deviates most: `point_m`, `deviation_m`, `std_m`, `area_m2`; the largest first

    def content(self) -> dict[str, Any]:
        """For JSON; files as absolute paths."""
        return {**vars(self), "files": {name: str(path) for name, path in self.files.items()}}


def row_of(piece: Piece, state: str, step: str, error: str, mean: tuple[str, float] | None = None) -> Row:
    """What the results of an object's steps say. Raises DatasetError: one is damaged.

    Args:
        mean: name of the mean piece of its kind, and how far it is from that (RMS) [m], if that is known.
    """
    results = {one.kind: one.read() for one in piece.steps if one.done}
    output = {kind: result["output"] for kind, result in results.items()}
    evaluation = {**output.get("eval", {}).get("mean", {}), **output.get("eval", {}).get("mesh", {})}
    figures = {key: float(evaluation[key]) for key in FIGURES if isinstance(evaluation.get(key), int | float)}
    place, there = piece.place, {}
    for kind, name in (("report", f"{REPORT}/{INDEX}"), ("mesh", MESH), ("asset", ASSET), ("compare", f"{COMPARE}/{INDEX}")):
        if kind in results:
            there[kind] = place / name
    shape: dict[str, Any] = {}
    if "compare" in results:
        shape = files.read_json(place / COMPARE / SHAPE)
        figures |= _deviations(shape)
    figures |= {} if mean is None else {"from_mean_mm": 1e3 * mean[1]}
    drawing = piece.item.drawing
    other = piece.reference or (drawing.name if drawing is not None else "")
    seconds = {kind: float(result["seconds"]) for kind, result in results.items()}
    return Row(
        piece.item.name,
        state,
        step,
        error,
        seconds,
        figures,
        there,
        other if "compare" in results else "",
        mean[0] if mean else "",
        shape.get("places", [])[:SHOWN],
    )


def _deviations(shape: Mapping[str, Any]) -> dict[str, float]:
    """The figures of a comparison; shares in per cent."""
    found = {f"deviation_{key}_mm": shape["deviation_m"][key] for key in ("mean", "rms", "p95")}
    found = {key: 1e3 * value for key, value in found.items() if value is not None}
    shares = {"within": (shape.get("within") or {}).get("share"), "significant": shape.get("significant_share")}
    found |= {key: 100 * value for key, value in shares.items() if value is not None}
    scales = {key: shape["aligned"].get(key) for key in ("scale", "scale_std")}
    return found | {key: float(value) for key, value in scales.items() if value is not None}


def standing_out(rows: Sequence[Row]) -> dict[str, str]:
    """Why a piece stands out, by its name: much of it deviates significantly, or it is far less like the others than they are."""
    found: dict[str, str] = {}
    for row in rows:
        share = row.figures.get("significant", 0.0)
        reasons = [f"{share:.1f} % of its surface deviates significantly"] if share > MOST_SIGNIFICANT else []
        if (mine := row.figures.get("from_mean_mm")) is not None:
            usual = statistics.median(one.figures["from_mean_mm"] for one in rows if one.mean == row.mean and one is not row)
            if mine > MOST_UNLIKE * usual:
                reasons.append(f"it is {mine:.3g} mm from the mean piece (RMS), the others {usual:.3g} mm (median)")
        if reasons and row.places:
            reasons.append(f"most {said(row.places[0])}")
        if reasons:
            found[row.name] = "; ".join(reasons)
    return found


def said(place: Mapping[str, Any]) -> str:
    """A place in words."""
    point = ", ".join(f"{1e3 * value:.0f}" for value in place["point_m"])
    std = "" if place["std_m"] is None else f" ± {1e3 * place['std_m']:.2f}"
    return f"at ({point}) mm, by {1e3 * place['deviation_m']:.2f}{std} mm"


def headings(rows: Sequence[Row]) -> dict[str, str]:
    """Heading of each figure that an object has, those of evaluations first."""
    known = {**{key: column_heading(key) for key in FIGURES}, **DEVIATIONS}
    return {key: words for key, words in known.items() if any(key in row.figures for row in rows)}


def csv_text(rows: Sequence[Row]) -> str:
    """A line for each object: state, seconds of each step, figures with all digits, and whether it stands out."""
    kinds = list(dict.fromkeys(kind for row in rows for kind in row.seconds))
    columns, out = list(headings(rows)), standing_out(rows)
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["object", "state", "step", "error", "stands_out", *(f"{kind}_s" for kind in kinds), *columns])
    for row in rows:
        values = [*(row.seconds.get(kind, "") for kind in kinds), *(row.figures.get(key, "") for key in columns)]
        writer.writerow([row.name, row.state, row.step, row.error, out.get(row.name, ""), *values])
    return buffer.getvalue()
