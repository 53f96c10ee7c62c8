"""Results of other programs, from a CSV file.

    program,scene,scale,seconds,psnr,normal_mae_deg,chamfer_mm,rays_per_s,view_s,note

Columns: `TEXT` and `NUMBERS`. `program`, `scene` and `seconds` (of training) are required; `view_s` is the time to render a
test view; scene and scale are those of the records (lego400 at 0.5). Other columns may be missing, and cells empty.
"""

import csv
import io
from pathlib import Path

from koala3d.datasets.core.errors import DatasetError, UsageError, nearest
from koala3d.reconstruct.bench.records import Row

TEXT = ("program", "scene", "note")
PICTURES = ("psnr", "ssim", "psnr_inside", "ssim_inside")
SHAPES = ("normal_mae_deg", "normal_mae_alpha_acc_deg", "depth_rmse_mm", "chamfer_mm")
NUMBERS = ("scale", "seconds", *PICTURES, *SHAPES, "rays_per_s", "view_s", "peak_memory_mb")
NEEDED = ("program", "scene", "seconds")


def read(path: Path) -> list[Row]:
    """One row per line, missing values as None; the default of `scale` is 1.

    Raises:
        UsageError: there is no such file.
        DatasetError: an unknown or missing column, or a cell that is not a number.
    """
    if not path.is_file():
        raise UsageError("no such file", where=path, remedy="give the CSV file with the results of other programs")
    reader = csv.DictReader(io.StringIO(path.read_text(encoding="utf-8")))
    columns = list(reader.fieldnames or [])
    for column in columns:
        if column not in (*TEXT, *NUMBERS):
            raise DatasetError(f"there is no column '{column}'", where=path, remedy=nearest(column, (*TEXT, *NUMBERS)))
    for column in NEEDED:
        if column not in columns:
            raise DatasetError(f"column '{column}' is missing", where=path, remedy=f"required: {', '.join(NEEDED)}")
    rows = []
    for number, line in enumerate(reader, 2):
        row: Row = {name: (line.get(name) or "").strip() for name in TEXT}
        for name in NUMBERS:
            row[name] = _number(line.get(name), f"{path}, line {number}, {name}")
        row["scale"] = row["scale"] or 1.0
        if not row["program"] or not row["scene"] or row["seconds"] is None:
            raise DatasetError("line is incomplete", where=f"{path}, line {number}", remedy=f"required: {', '.join(NEEDED)}")
        rows.append(row)
    return rows


def _number(text: str | None, where: str) -> float | None:
    if not (text or "").strip():
        return None
    try:
        return float(str(text))
    except ValueError:
        raise DatasetError("is not a number", where=where, why=repr(text)) from None
