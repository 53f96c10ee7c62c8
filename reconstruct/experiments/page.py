"""The HTML report of a benchmark: error against time, the cost of the work, and where the time of a step goes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.reports.html import Number, ReportPage
from koala3d.reconstruct.bench import drawings, targets
from koala3d.reconstruct.bench.records import DEFINITIONS, DONE, Records, Row, latest
from koala3d.reconstruct.bench.runner import PROFILES, RECORDS, profiles
from koala3d.reconstruct.bench.suite import COST, QUALITY
from koala3d.reconstruct.output import metric_names

REPORT = "index.html"
PICTURES = ("psnr", "ssim", "psnr_inside", "ssim_inside")
SHAPES = ("normal_mae_alpha_acc_deg", "normal_mae_deg", "normal_pred_mae_alpha_acc_deg", "depth_rmse_mm", "chamfer_mm")
COLUMNS = (*PICTURES, *SHAPES, "seconds")  # metrics in the table of all points
RATES = ("steps", "rays_per_s", "samples_per_s", "peak_memory_mb")
RATE_HEADINGS = ("steps", "rays/s", "samples/s", "memory [MB]")
SPEEDS = (("training rays", "rays_per_s", "rays_per_s", "1/s"), ("rendering a view", "view_s", "seconds", "s"))


def write(out: Path, peers: Sequence[Row] = (), *, made_by: Sequence[str] = ()) -> Path:
    """Write the report of the benchmark in `out`, replacing an earlier one; arguments as for `render`."""
    files.write_text(out / REPORT, render(out, peers, made_by=made_by))
    return out / REPORT


def render(out: Path, peers: Sequence[Row] = (), *, made_by: Sequence[str] = ()) -> str:
    """The report of the benchmark in `out` as HTML.

    Args:
        peers: results of other programs, from `peers.read`.
        made_by: command lines that made the benchmark; default: the one without options.
    """
    rows = Records(out / RECORDS).rows()
    done = latest(rows)
    page = ReportPage("Run time against error", made_by=made_by or [f"reconstruct bench --out {out}"])
    quality = [row for row in done if row["kind"] == QUALITY]
    page.headline([(f"trials, {name}", Number(float(count), digits=0)) for name, count in _counts(rows).items()], _about(done))
    _targets(page, quality)
    _curves(page, quality, peers)
    _points(page, quality)
    _peers(page, done, peers)
    _costs(page, [row for row in done if row["kind"] == COST])
    _profiles(page, profiles(out))
    _context(page, done, rows)
    return page.render()


def _counts(rows: Sequence[Row]) -> dict[str, int]:
    failed = sum(row["status"] != DONE for row in rows)
    return {"measured": len(latest(rows))} | ({"failed": failed} if failed else {})


def _about(rows: Sequence[Row]) -> str:
    machines = sorted({f"{row['machine']}, {row['cores']:g} cores" for row in rows})
    loads = [row["load"] for row in rows if row["load"] is not None]
    load = f"; load between {min(loads):.1f} and {max(loads):.1f} when trials started" if loads else ""
    budget = "The budget counts training steps only, not reading, compiling or evaluating."
    return f"{'; '.join(machines)}{load}. Each point is one training with schedules that end with its budget. {budget}"


def _targets(page: ReportPage, rows: Sequence[Row]) -> None:
    found = targets.outcomes(rows)
    if not found:
        return
    page.section("Targets", "Model surfnerf, fast preset; mean over test views, seeds and measured scenes.")
    verdicts = {True: "met", False: "not met", None: "some scenes are missing"}
    body = []
    for one in found:
        target, metric = one.target, metric_names.column_heading(one.target.metric)
        values = (Number(target.value), Number(one.reached), verdicts[one.met])
        body.append((target.name, metric, *values, len(one.scenes), one.seeds))
    page.table(("target", "metric", "wanted", "reached", "", "scenes", "seeds"), body)


def _curves(page: ReportPage, rows: Sequence[Row], peers: Sequence[Row]) -> None:
    legend = "Lines: mean over seeds. Bars: best to worst seed. Grey: the Pareto front of these trainings."
    page.section("Error against time", legend)
    for (scene, scale), block in groups(rows, "scene", "scale").items():
        page.heading(f"{scene}{'' if scale == 1 else f' at scale {scale:g}'}")
        page.drawing(drawings.pareto(block, [peer for peer in peers if (peer["scene"], peer["scale"]) == (scene, scale)]))


def _points(page: ReportPage, rows: Sequence[Row]) -> None:
    weighting = "Normal errors are weighted by true alpha times rendered opacity, or by alpha only."
    page.section("All points", f"Mean and standard deviation over seeds. {weighting}")
    columns = [name for name in COLUMNS if any(row.get(name) is not None for row in rows)]
    body = []
    for (scene, scale, model, preset, budget), block in groups(rows, "scene", "scale", "model", "preset", "budget_s").items():
        values = [_mean(block, name) for name in columns] + [_mean(block, name, digits=0) for name in RATES]
        body.append((f"{scene} at {scale:g}", model, preset, Number(budget, "s", digits=0), len(block), *values))
    headings = [metric_names.column_heading(name) for name in columns]
    page.table(("scene", "model", "preset", "budget", "seeds", *headings, *RATE_HEADINGS), body)
    page.items(f"{name}: {meaning}" for name, meaning in DEFINITIONS.items())


def _mean(rows: Sequence[Row], name: str, *, digits: int | None = None) -> Number:
    values = [row[name] for row in rows if row.get(name) is not None]
    if not values:
        return Number(None)
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else None
    if spread is not None and spread <= 1e-9 * abs(float(np.mean(values))):  # equal values: rounding of their mean only
        spread = None
    return Number(float(np.mean(values)), std=spread if digits is None else None, digits=digits)


def _peers(page: ReportPage, rows: Sequence[Row], peers: Sequence[Row]) -> None:
    """Rates of other programs beside the median over all trials of the same scene."""
    body = []
    for peer in peers:
        scene = f"{peer['scene']} at {peer['scale']:g}"
        same = [row for row in rows if (row["scene"], row["scale"]) == (peer["scene"], peer["scale"])]
        for what, theirs, ours, unit in SPEEDS:
            values = [row[ours] for row in same if row[ours]]
            if peer[theirs] and values:
                own = float(np.median(values))
                ratio = Number(own / peer[theirs] if unit == "1/s" else peer[theirs] / own, "times", digits=0)
                body.append((peer["program"], scene, what, Number(peer[theirs], unit), Number(own, unit), ratio, peer["note"]))
    if body:
        page.section("Speed of other programs", "Training rays include those that miss the object, which cost little here.")
        page.table(("program", "scene", "what", "theirs", "here", "faster", "note"), body)


def _costs(page: ReportPage, rows: Sequence[Row]) -> None:
    if not rows:
        return
    page.section("Cost against the size and number of images")
    body = []
    for (scene, width, height, views, model), block in groups(rows, "scene", "width", "height", "train_views", "model").items():
        step = Number(float(np.mean([1e3 * row["training_s"] / max(row["steps"], 1) for row in block])), "ms")
        times = (_mean(block, "preparation_s"), step, _mean(block, "seconds"), _mean(block, "peak_memory_mb", digits=0))
        body.append((scene, f"{width:g}x{height:g}", int(views), model, *times))
    page.table(("scene", "size", "images", "model", "reading [s]", "step", "rendering a view [s]", "memory [MB]"), body)
    lines = []
    for name, cold in (("compiled", 1), ("loaded from the cache", 0)):
        if values := [row["compilation_s"] for row in rows if row["cold"] == cold]:
            lines.append(f"the training step, {name}: {np.median(values):.1f} s (median of {len(values)})")
    page.items(lines)


def _profiles(page: ReportPage, found: dict[str, Any]) -> None:
    if not found:
        return
    about = "From a trace of the compiled step; each instruction counts for the source that it comes from."
    page.section("Where the time of a step goes", f"{about} With two cores, the parts may sum to more than the step.")
    for name, one in found.items():
        page.heading(name)
        second = one["second_pass_step_ms"]
        extra = f"; {second:.1f} ms with the second pass of the regularisers" if second else ""
        page.paragraph(f"{one['step_ms']:.1f} ms per step of {one['rays']} rays and {one['samples']} samples{extra}.")
        page.drawing(drawings.parts(one["parts"]))
        rows = [(stage, kernel, way, Number(ms, "ms", digits=2)) for stage, kernel, way, ms in one["parts"][:24]]
        page.table(("stage", "kernel", "pass", "time"), rows)


def _context(page: ReportPage, done: Sequence[Row], rows: Sequence[Row]) -> None:
    page.section("Machine and versions", f"From {RECORDS}; profiles are in {PROFILES}.")
    kept = ("machine", "cores", "memory_gb", "python", "jax", "jaxlib", "numpy", "commit")
    text_of = lambda value: f"{value:g}" if isinstance(value, float) else value  # noqa: E731
    page.table(("trials", *kept), [(len(block), *map(text_of, place)) for place, block in groups(done, *kept).items()])
    name_of = lambda row: "-".join(str(row[key]) for key in ("kind", "scene", "model", "budget_s", "seed"))  # noqa: E731
    page.items(f"error: {name_of(row)} {row['status']}" for row in rows if row["status"] != DONE)


def groups(rows: Sequence[Row], *names: str) -> dict[tuple[Any, ...], list[Row]]:
    """Rows by the values of some columns, in order of first appearance."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[name] for name in names), []).append(row)
    return found
