"""Error against time: the trainings of sweeps as a table, docs/curve.csv, which `make figures` draws.

    python -m tests.bench.curve SWEEP... --out docs/curve.csv

Each training ends with its budget: none is looked at on its way.
"""

import argparse
import csv
import io
from collections.abc import Sequence
from pathlib import Path

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.experiments.results import RESULTS, Result

COLUMNS = (
    "scene",
    "width_px",
    "seed",
    "budget_s",
    "training_s",
    "start_s",
    "steps",
    "psnr_db",
    "normals_deg",
    "chamfer_mm",
)


def row(result: Result) -> tuple[str, ...]:
    """The columns of a result; what was not measured is empty."""
    figures, work = result.evaluation, result.work
    means, mesh = figures["mean"], figures.get("mesh") or {}
    start = work["preparation_s"] + work["compilation_s"]
    numbers = (
        (figures["size"][0], ".0f"),
        (result.seed, ".0f"),
        (result.origin.budget_s, ".0f"),
        (work["training_s"], ".1f"),
        (start, ".1f"),
        (work["steps"], ".0f"),
        (means["psnr"], ".2f"),
        (means.get("normal_mae_alpha_acc_deg"), ".2f"),
        (mesh.get("chamfer_mm"), ".3f"),
    )
    return result.scene, *("" if number is None else f"{number:{form}}" for number, form in numbers)


def table(sweeps: Sequence[Path]) -> str:
    """The table of all results below these folders, by scene, size and time. Raises UsageError where there are none."""
    found = [row(Result.read(path)) for sweep in sweeps for path in sorted(sweep.glob(RESULTS))]
    if not found:
        raise UsageError("hold no results", where=", ".join(map(str, sweeps)), remedy="run: reconstruct sweep --budget 5 ...")
    ordered = sorted(found, key=lambda one: (one[0], int(one[1]), float(one[3] or 0), int(one[2])))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([COLUMNS, *ordered])
    return text.getvalue()


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sweeps", type=Path, nargs="+", metavar="SWEEP", help="folder of a sweep with budgets")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.csv")
    asked = parser.parse_args()
    files.write_text(asked.out, table(asked.sweeps))


if __name__ == "__main__":
    main()
