"""`reconstruct sweep` and `reconstruct table`."""

from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from koala3d.datasets.core import console
from koala3d.reconstruct.options import Preset, Settings

WHERE = "Where"


def sweep(
    out: Annotated[Path, Option("--out", help="Folder to write; an interrupted sweep in it is resumed.")],
    scenes: Annotated[list[str], Option("--scene", help="Scene folder, as for 'train'; repeatable.")],
    models: Annotated[list[str] | None, Option("--model", help="Model, see 'models'; repeatable. Default: surfnerf.")] = None,
    preset: Preset = "fast",
    set_: Settings = None,
    tried: Annotated[
        list[str] | None,
        Option(
            "--try",
            metavar="SETTING",
            help="Also train with KEY=VALUE, with one of the paper's ablations by name, or with 'paper' for all; repeatable.",
        ),
    ] = None,
    budgets: Annotated[
        list[float] | None, Option("--budget", help="Seconds of training; repeatable. Default: train.steps steps.")
    ] = None,
    seeds: Annotated[
        list[int] | None, Option("--seed", min=0, help="Seed; repeatable: tables then show means and standard deviations.")
    ] = None,
    plan_only: Annotated[bool, Option("--plan", help="List the trainings without running them.")] = False,
    ray: Annotated[bool, Option("--ray", help="Run as Ray tasks (extra 'sweep').", rich_help_panel=WHERE)] = False,
    address: Annotated[
        str | None, Option("--address", help="Ray cluster to use; default: this machine.", rich_help_panel=WHERE)
    ] = None,
    as_json: console.Json = False,
) -> None:
    """Train and evaluate scenes x models x settings x budgets x seeds; write a table and a page."""
    from koala3d.reconstruct.experiments import sweep as sweeps

    axes = {"settings": tried or (), "budgets": budgets or (), "seeds": seeds or ()}
    jobs = sweeps.plan(scenes, models or ["surfnerf"], preset, set_ or (), out, **axes)
    if plan_only:
        return console.report({"trainings": [job.name for job in jobs]}, as_json=as_json, text=sweeps.listing(jobs))
    if ray or address is not None:
        from koala3d.reconstruct.experiments import on_ray  # Ray is optional

        run_all = partial(on_ray.run_all, address=address)
    else:
        from koala3d.reconstruct.experiments.runner import run_all
    result = sweeps.run(jobs, out, run_all)
    text = (out / "table.md").read_text(encoding="utf-8").rstrip()
    console.report(result, as_json=as_json, text=f"{text}\n{out / sweeps.PAGE}")


def table(
    folders: Annotated[list[Path], Argument(metavar="FOLDER...", help="Folders made by 'sweep', or evaluated runs.")],
    against: Annotated[
        Path | None, Option(metavar="FOLDER", help="Another sweep: say which differences from it exceed the noise of seeds.")
    ] = None,
    out: Annotated[
        Path | None, Option("--out", metavar="FILE", help="File to write: FILE.md, .csv or .tex, or the page FILE.html.")
    ] = None,
    columns: Annotated[list[str] | None, Option("--column", help="Metric to show; repeatable.")] = None,
    per_image: Annotated[bool, Option("--per-image", help="Write one row per image instead of one per training.")] = False,
    everything: Annotated[bool, Option("--all", help="With --against: also differences within the noise.")] = False,
    as_json: console.Json = False,
) -> None:
    """Show the figures of sweeps and runs in the paper's layout, a row for all seeds; or compare them with another sweep."""
    from koala3d.datasets.core import files
    from koala3d.datasets.core.errors import UsageError
    from koala3d.reconstruct.experiments import comparison, page, results, tables

    found = results.results_of(folders)
    if against is not None:
        differences = comparison.compare(results.rows_of(results.results_of([against])), results.rows_of(found))
        if not differences:
            raise UsageError("the two have no training in common", where=f"{folders[0]}, {against}")
        if out is not None:
            tables.refuse_other(out, (".html",))
            files.write_text(out, page.of_comparison(f"{folders[0].name} against {against.name}", differences))
        said = comparison.text(differences, everything=everything)
        return console.report(comparison.summary(differences), as_json=as_json, text=said + (f"\n{out}" if out else ""))
    rows = results.rows_of(found, per_image=per_image)
    chosen = tables.chosen_columns(rows, columns or ())
    if out is not None:
        tables.refuse_other(out, (*tables.FORMATS, ".html"))
        of_page = out.suffix == ".html"
        files.write_text(out, page.of_results(folders[0].name, found) if of_page else tables.FORMATS[out.suffix](rows, chosen))
    content = [{"scene": row.scene, "model": row.label, **row.content(chosen)} for row in rows]
    text = tables.markdown(rows, chosen).rstrip() + (f"\n{out}" if out else "")
    console.report({"rows": content}, as_json=as_json, text=text)
