"""The page of a sweep: gains over the base, error against time, all figures, what the work cost, machines; or a comparison."""

from collections.abc import Mapping, Sequence
from typing import Any

from koala3d.datasets.reports.html import Number, ReportPage
from koala3d.reconstruct.experiments import comparison, drawings, tables
from koala3d.reconstruct.experiments.comparison import Difference
from koala3d.reconstruct.experiments.results import WORK, Result, Row, rows_of
from koala3d.reconstruct.output import metric_names

SHAPES = ("normal_pred_mae_alpha_acc_deg", "depth_rmse_mm", "diffuse_psnr", "specular_psnr", "chamfer_mm", "seconds")
COLUMNS = (*tables.COLUMNS, *SHAPES)
HEADINGS = ("steps", "training [s]", "reading [s]", "compiling [s]", "rays/s", "samples/s", "memory [MB]")
KEPT = ("machine", "cores", "python", "jax", "jaxlib", "numpy", "commit")


def of_results(
    title: str,
    results: Sequence[Result],
    *,
    settings: Mapping[str, Sequence[str]] | None = None,
    made_by: Sequence[str] = (),
) -> str:
    """The page of results as HTML.

    Args:
        settings: overrides of each setting, by "MODEL, SETTING".
        made_by: command lines that made them.
    """
    rows, page = rows_of(results), ReportPage(title, made_by=made_by)
    columns = tables.chosen_columns(rows, COLUMNS)
    counts = {"scenes": len({row.scene for row in rows}), "rows": len(rows), "trainings": len(results)}
    page.headline([(name, Number(float(count), digits=0)) for name, count in counts.items()], _machines(results))
    _gains(page, rows)
    _curves(page, rows)
    page.section("All figures", _spread(rows))
    headings = [metric_names.column_heading(name) for name in columns]
    page.table(("scene", "model", *headings), [(row.scene, row.label, *(_number(row, name) for name in columns)) for row in rows])
    page.items(tables.notes(rows, columns))
    if changed := {name: " ".join(changes) for name, changes in (settings or {}).items() if changes}:
        page.section("Settings")
        page.table(("setting", "changes"), list(changed.items()))
    _work(page, rows)
    page.section("Machines and versions")
    known = [one.machine for one in results if one.machine]
    places = dict.fromkeys(tuple(str(machine.get(name, "")) for name in KEPT) for machine in known)
    page.table(KEPT, list(places))
    return page.render()


def of_comparison(title: str, differences: Sequence[Difference]) -> str:
    """The page of a comparison as HTML: all differences, those that exceed the noise first."""
    page, told = ReportPage(title), comparison.summary(differences)
    counts = [
        (verdict, sum(one.verdict == verdict for one in differences)) for verdict in ("better", "worse", "noise", "unknown")
    ]
    words = f"{told['test']}; {told['expected_false_alarms']:g} false alarms expected among {told['tested']} tests"
    page.headline([(name, Number(float(count), digits=0)) for name, count in counts], words)
    page.section("Differences")
    clear = sorted(differences, key=lambda one: one.verdict not in ("better", "worse"))
    changed = lambda one: (one.before, one.after, one.change.value, one.change.low, one.change.high)  # noqa: E731
    body = [(one.verdict, one.place, one.figure, *map(Number, changed(one))) for one in clear]
    page.table(("", "where", "figure", "before", "after", "change", "from", "to"), body)
    return page.render()


def _machines(results: Sequence[Result]) -> str:
    known = [one.machine for one in results if one.machine]
    named = sorted({f"{machine['machine']}, {machine['cores']} cores" for machine in known})
    loads = [machine["load"] for machine in known]
    return "; ".join(named) + (f"; load between {min(loads):.1f} and {max(loads):.1f} when trainings started" if loads else "")


def _gains(page: ReportPage, rows: Sequence[Row]) -> None:
    """A drawing for each scene, model and budget with a base and other settings."""
    blocks: dict[Any, list[Row]] = {}
    for row in rows:
        blocks.setdefault((row.scene, row.origin.model, row.origin.budget_s), []).append(row)
    whole = [block for block in blocks.values() if len(block) > 1 and block[0].origin.setting == "base"]
    if whole:
        page.section("Gain over the base", f"Better is to the right. {_uncertainty(rows)}")
    for base, *others in whole:
        page.heading(f"{base.scene}, {base.label}")
        page.drawing(drawings.gains(base, others))


def _curves(page: ReportPage, rows: Sequence[Row]) -> None:
    by_scene = {row.scene: [other for other in rows if other.scene == row.scene] for row in rows}
    several = {name: block for name, block in by_scene.items() if len({row.origin.budget_s for row in block} - {None}) > 1}
    if several:
        words = (
            "Each point is a training whose schedules end with its budget. Bars: standard deviation over seeds. Grey: the front."
        )
        page.section("Error against time", words)
    for name, block in several.items():
        page.heading(name)
        page.drawing(drawings.curves(block))


def _work(page: ReportPage, rows: Sequence[Row]) -> None:
    if any("steps" in row.values for row in rows):
        page.section("Work")
        body = [(row.scene, row.label, *(_number(row, name) for name in WORK)) for row in rows]
        page.table(("scene", "model", *HEADINGS), body)
        page.items(f"{heading}: {meaning}" for heading, meaning in zip(HEADINGS, WORK.values(), strict=True))


def _number(row: Row, name: str) -> Number:
    return Number(row.values.get(name), std=row.deviations.get(name))


def _spread(rows: Sequence[Row]) -> str:
    return "Mean ± standard deviation over seeds." if max(row.seeds for row in rows) > 1 else ""


def _uncertainty(rows: Sequence[Row]) -> str:
    """How reliable the differences are."""
    if max(row.seeds for row in rows) == 1:
        return "One seed each: small differences may be noise."
    return "Bars: differences of the means over seeds. Lines: 95 % confidence intervals (Welch); one that includes zero is noise."
