"""Commands that train and compare several runs: table, ablate, sweep."""

from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option, Typer

from koala3d.datasets.core import console
from koala3d.reconstruct.options import Budget, ModelName, Preset, SceneName, Seeds, Settings, StudyFolder

app = Typer()


@app.command()
def table(
    runs: Annotated[list[Path], Argument(metavar="RUN...", help="Evaluated runs.")],
    out: Annotated[Path | None, Option("--out", metavar="FILE", help="File to write: FILE.md, FILE.csv or FILE.tex.")] = None,
    columns: Annotated[list[str] | None, Option("--column", help="Metric to show; repeatable.")] = None,
    per_image: Annotated[bool, Option("--per-image", help="Write one row per image instead of one per run.")] = False,
    as_json: console.Json = False,
) -> None:
    """Compare the metrics of runs in the paper's layout. Runs that differ only in their seed share a row."""
    from koala3d.reconstruct.studies import results, results_table

    rows = results.rows_of_runs(runs, per_image=per_image)
    chosen = results_table.chosen_columns(rows, columns or ())
    if out is not None:
        results_table.write(rows, chosen, out)
    content = [{"scene": row.scene, "model": row.label, **row.content(chosen)} for row in rows]
    text = results_table.markdown(rows, chosen).rstrip() + (f"\n{out}" if out else "")
    console.report({"rows": content}, as_json=as_json, text=text)


@app.command()
def ablate(
    scene: SceneName,
    out: StudyFolder,
    model: ModelName = "surfnerf",
    preset: Preset = "fast",
    budget: Budget = None,
    cells: Annotated[list[str] | None, Option("--cell", help="Cell to train besides the base; repeatable.")] = None,
    set_: Settings = None,
    seeds: Seeds = None,
    plan_only: Annotated[bool, Option("--plan", help="List the cells and their changes without training.")] = False,
    as_json: console.Json = False,
) -> None:
    """Train a model repeatedly with one change at a time; write a table and a figure."""
    from koala3d.reconstruct.backend import cache_compilations
    from koala3d.reconstruct.studies import ablate

    study = ablate.plan(scene, model, preset, set_ or (), budget, cells or (), seeds or ())
    if plan_only:
        text = "\n".join(f"{name:<20}{' '.join(changes) or '-'}" for name, changes in study.cells.items())
        return console.report({"cells": study.cells}, as_json=as_json, text=text)
    cache_compilations()
    _report_table(ablate.run(study, out), out, as_json)


@app.command()
def sweep(
    out: StudyFolder,
    scenes: Annotated[list[str], Option("--scene", help="Scene folder, as for 'train'; repeatable.")],
    models: Annotated[list[str], Option("--model", help="Model, see 'reconstruct models'; repeatable.")],
    preset: Preset = "fast",
    budget: Budget = None,
    set_: Settings = None,
    seeds: Seeds = None,
    ray: Annotated[bool, Option("--ray", help="Run as Ray tasks (extra 'sweep').")] = False,
    address: Annotated[str | None, Option("--address", help="Ray cluster to use; default: this machine.")] = None,
    as_json: console.Json = False,
) -> None:
    """Train and evaluate every model on every scene; write a table."""
    from koala3d.reconstruct.studies import sweep

    jobs = sweep.plan(scenes, models, preset, set_ or (), budget, out, seeds or ())
    _report_table(sweep.run(jobs, out, use_ray=ray or address is not None, ray_address=address), out, as_json)


def _report_table(result: dict[str, Any], out: Path, as_json: bool) -> None:
    console.report(result, as_json=as_json, text=f"{(out / 'table.md').read_text(encoding='utf-8').rstrip()}\n{out}")
