"""The page of a benchmark: curves of error against seconds, what the work costs, where the time of a step goes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from datasets.core import files
from datasets.reports.html import Number, ReportPage
from reconstruct.bench import drawings, targets
from reconstruct.bench.records import DEFINITIONS, DONE, Records, Row, latest
from reconstruct.bench.runner import PROFILES, RECORDS, profiles
from reconstruct.bench.suite import COST, QUALITY
from reconstruct.output import metric_names

PAGE = "index.html"
COLUMNS = ("psnr", "ssim", "normal_mae_alpha_acc_deg", "normal_mae_deg", "normal_pred_mae_alpha_acc_deg", "depth_rmse_mm",
           "chamfer_mm", "seconds")  # fmt: skip
"""Figures of the table of points."""


def write(out: Path, peers: Sequence[Row] = (), *, made_by: Sequence[str] = ()) -> Path:
    """Write (or write again) the page of the benchmark in `out`.

    Args:
        peers: what other programs reach, from `peers.read`.
        made_by: command lines that led to it; None takes the plain one.
    """
    rows = Records(out / RECORDS).rows()
    done = latest(rows)
    page = ReportPage("Run time against error", made_by=made_by or [f"reconstruct bench --out {out}"])
    quality = [row for row in done if row["kind"] == QUALITY]
    page.headline([(f"trials, {name}", Number(float(count), digits=0)) for name, count in _counts(rows).items()], _where(done))
    _targets(page, quality)
    _curves(page, quality, peers)
    _points(page, quality)
    _against_peers(page, done, peers)
    _costs(page, [row for row in done if row["kind"] == COST])
    _profiles(page, profiles(out))
    _context(page, done, rows)
    files.write_text(out / PAGE, page.render())
    return out / PAGE


def _counts(rows: Sequence[Row]) -> dict[str, int]:
    finished = len(latest(rows))
    failed = sum(row["status"] != DONE for row in rows)
    return {"measured": finished} | ({"failed": failed} if failed else {})


def _where(rows: Sequence[Row]) -> str:
    machines = sorted({f"{row['machine']}, {row['cores']:g} cores" for row in rows})
    loads = [row["load"] for row in rows if row["load"] is not None]
    busy = f"; load between {min(loads):.1f} and {max(loads):.1f} when trials began" if loads else ""
    return f"{'; '.join(machines)}{busy}. Each point is one training with that budget, its schedules ending with it; reading, compiling and measuring are off its clock."


def _targets(page: ReportPage, rows: Sequence[Row]) -> None:
    found = targets.outcomes(rows)
    if not found:
        return
    page.section(
        "What was meant to be reached",
        "Model surfnerf, fast preset, mean over test views, seeds and the scenes that were measured.",
    )
    words = {True: "met", False: "not met", None: "some scenes are not measured"}
    page.table(("target", "figure", "wanted", "reached", "", "scenes", "seeds"),
               [(one.target.words, metric_names.column_heading(one.target.figure), Number(one.target.value), Number(one.reached), words[one.met],
                 len(one.scenes), one.seeds) for one in found])  # fmt: skip


def _curves(page: ReportPage, rows: Sequence[Row], peers: Sequence[Row]) -> None:
    page.section("Error against time", "Lines are means over seeds, bars reach from the best seed to the worst. The grey line is what nothing measured here is "
                 "better than at less time (Pareto).")  # fmt: skip
    for (scene, scale), block in groups(rows, "scene", "scale").items():
        page.heading(f"{scene}{'' if scale == 1 else f' at {scale:g} of its size'}")
        others = [peer for peer in peers if peer["scene"] == scene and peer["scale"] == scale]
        page.drawing(drawings.pareto(block, others))


def _points(page: ReportPage, rows: Sequence[Row]) -> None:
    page.section(
        "All points",
        "Mean and standard deviation over seeds. Normal errors in both definitions: weighted by true alpha times rendered opacity, and by alpha alone.",
    )
    columns = [name for name in COLUMNS if any(row.get(name) is not None for row in rows)]
    body = []
    for (scene, scale, model, preset, budget), block in groups(rows, "scene", "scale", "model", "preset", "budget_s").items():
        figures = [_mean(block, name) for name in columns]
        work = [
            _mean(block, name, digits=digits)
            for name, digits in (("steps", 0), ("rays_per_s", 0), ("samples_per_s", 0), ("peak_memory_mb", 0))
        ]
        body.append((f"{scene} at {scale:g}", model, preset, Number(budget, "s", digits=0), len(block), *figures, *work))
    page.table(
        (
            "scene",
            "model",
            "preset",
            "budget",
            "seeds",
            *(metric_names.column_heading(name) for name in columns),
            "steps",
            "rays/s",
            "samples/s",
            "memory [MB]",
        ),
        body,
    )
    page.items(f"{name}: {meaning}" for name, meaning in DEFINITIONS.items())


def _mean(rows: Sequence[Row], name: str, *, digits: int | None = None) -> Number:
    values = [row[name] for row in rows if row.get(name) is not None]
    if not values:
        return Number(None)
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else None
    if spread is not None and spread <= 1e-9 * abs(float(np.mean(values))):  # the same bits, but for the rounding of their mean
        spread = None
    return Number(float(np.mean(values)), std=spread if digits is None else None, digits=digits)


def _against_peers(page: ReportPage, rows: Sequence[Row], peers: Sequence[Row]) -> None:
    """Rates beside those of other programs: of the median of all trials of the scene."""
    body = []
    for peer in peers:
        same = [row for row in rows if row["scene"] == peer["scene"] and row["scale"] == peer["scale"]]
        for words, theirs, ours, unit in (
            ("training rays", "rays_per_s", "rays_per_s", "1/s"),
            ("rendering a view", "view_s", "seconds", "s"),
        ):
            values = [row[ours] for row in same if row[ours]]
            if peer[theirs] and values:
                own = float(np.median(values))
                ratio = own / peer[theirs] if unit == "1/s" else peer[theirs] / own
                body.append((peer["program"], f"{peer['scene']} at {peer['scale']:g}", words, Number(peer[theirs], unit), Number(own, unit),
                             Number(ratio, "times", digits=0), peer["note"]))  # fmt: skip
    if body:
        page.section(
            "Speed beside other programs",
            "Rays drawn from the training pictures; those that meet nothing cost this program little, and count.",
        )
        page.table(("program", "scene", "what", "theirs", "here", "faster", "note"), body)


def _costs(page: ReportPage, rows: Sequence[Row]) -> None:
    if not rows:
        return
    page.section("Cost against the size and number of pictures")
    body = []
    for (scene, width, height, views, model), block in groups(rows, "scene", "width", "height", "train_views", "model").items():
        step = float(np.mean([1e3 * row["training_s"] / max(row["steps"], 1) for row in block]))
        body.append((scene, f"{width:g}x{height:g}", int(views), model, _mean(block, "preparation_s"), Number(step, "ms"),
                     _mean(block, "seconds"), _mean(block, "peak_memory_mb", digits=0)))  # fmt: skip
    page.table(("scene", "size", "pictures", "model", "to read [s]", "step", "to render one [s]", "memory [MB]"), body)
    compiled = [
        (name, [row["compilation_s"] for row in rows if row["cold"] == cold])
        for name, cold in (("compiling", 1), ("from the disk", 0))
    ]
    page.items(
        f"the training step, {name}: {np.median(values):.1f} s (median of {len(values)})" for name, values in compiled if values
    )


def _profiles(page: ReportPage, found: dict[str, Any]) -> None:
    if not found:
        return
    page.section("Where the time of a step goes", "The compiled step is traced; each instruction counts for the code that it comes from. With two cores, the sum of "
                 "the parts may exceed the time on the clock.")  # fmt: skip
    for name, one in found.items():
        page.heading(name)
        second = one["second_pass_step_ms"]
        page.paragraph(f"{one['step_ms']:.1f} ms per step of {one['rays']} rays and {one['samples']} samples"
                       + (f"; {second:.1f} ms with the second pass of the regularisers." if second else "."))  # fmt: skip
        page.drawing(drawings.parts(one["parts"]))
        page.table(
            ("stage", "work", "pass", "time"),
            [(stage, kernel, way, Number(ms, "ms", digits=2)) for stage, kernel, way, ms in one["parts"][:24]],
        )


def _context(page: ReportPage, done: Sequence[Row], rows: Sequence[Row]) -> None:
    page.section("Machine and versions", f"Every line of {RECORDS} carries them; profiles are in {PROFILES}.")
    kept = ("machine", "cores", "memory_gb", "python", "jax", "jaxlib", "numpy", "commit")
    page.table(("trials", *kept), [(len(block), *(f"{value:g}" if isinstance(value, float) else value for value in place))
                                   for place, block in groups(done, *kept).items()])  # fmt: skip
    page.items(f"error: {'-'.join(str(row[key]) for key in ('kind', 'scene', 'model', 'budget_s', 'seed'))} {row['status']}"
               for row in rows if row["status"] != DONE)  # fmt: skip


def groups(rows: Sequence[Row], *names: str) -> dict[tuple[Any, ...], list[Row]]:
    """Rows by the values of some columns, in the order in which they first appear."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[name] for name in names), []).append(row)
    return found
