"""What other programs reach, from a CSV that a person writes.

    program,scene,scale,seconds,psnr,normal_mae_deg,normal_mae_alpha_acc_deg,depth_rmse_mm,chamfer_mm,rays_per_s,view_s,peak_memory_mb,note

`program`, `scene` and `seconds` (of training) are needed; `view_s` is the time to render a test view; scene and scale as in the records (lego400 at 0.5). Columns may be left out, and cells be empty.
"""

import csv
import io
from pathlib import Path

from datasets.core.errors import DatasetError, UsageError, nearest
from reconstruct.bench.records import Row

TEXT = ("program", "scene", "note")
NUMBERS = ("scale", "seconds", "psnr", "ssim", "normal_mae_deg", "normal_mae_alpha_acc_deg", "depth_rmse_mm", "chamfer_mm",
           "rays_per_s", "view_s", "peak_memory_mb")  # fmt: skip
NEEDED = ("program", "scene", "seconds")


def read(path: Path) -> list[Row]:
    """One row per line; numbers as numbers, what is not given as None. `scale` is 1 where it is not given.

    Raises:
        UsageError: there is no such file.
        DatasetError: an unknown or missing column, or a cell that is no number.
    """
    if not path.is_file():
        raise UsageError("no such file", where=path, remedy="give the CSV with the figures of other programs")
    reader = csv.DictReader(io.StringIO(path.read_text(encoding="utf-8")))
    columns = list(reader.fieldnames or [])
    for column in columns:
        if column not in (*TEXT, *NUMBERS):
            raise DatasetError(f"no column is called '{column}'", where=path, remedy=nearest(column, (*TEXT, *NUMBERS)))
    for column in NEEDED:
        if column not in columns:
            raise DatasetError(f"column '{column}' is missing", where=path, remedy=f"needed: {', '.join(NEEDED)}")
    rows = []
    for number, line in enumerate(reader, 2):
        row: Row = {name: (line.get(name) or "").strip() for name in TEXT}
        for name in NUMBERS:
            row[name] = _number(line.get(name), f"{path}, line {number}, {name}")
        row["scale"] = row["scale"] or 1.0
        if not row["program"] or not row["scene"] or row["seconds"] is None:
            raise DatasetError("line is not complete", where=f"{path}, line {number}", remedy=f"needed: {', '.join(NEEDED)}")
        rows.append(row)
    return rows


def _number(text: str | None, where: str) -> float | None:
    if not (text or "").strip():
        return None
    try:
        return float(str(text))
    except ValueError:
        raise DatasetError("is no number", where=where, why=repr(text)) from None
