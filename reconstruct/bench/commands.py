"""The commands below `reconstruct bench`; `reconstruct.cli` registers them."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Context, Option, Typer

from koala3d.datasets.core import console

app = Typer(help="Measure run time against error.", rich_markup_mode=None, invoke_without_command=True)


@app.callback()
def bench_command(
    context: Context,
    out: Annotated[Path | None, Option("--out", help="Folder to write; an interrupted benchmark is resumed.")] = None,
    suite: Annotated[str, Option(help="quick: ten minutes on two cores; full: most of a day.")] = "quick",
    peer: Annotated[Path | None, Option(metavar="FILE.csv", help="Results of other programs, to be drawn as well.")] = None,
    data: Annotated[Path | None, Option(help="Folder with the real scenes; default: the usual places.")] = None,
    scenes: Annotated[list[str] | None, Option("--scene", help="Scene to include; repeatable.")] = None,
    scales: Annotated[list[float] | None, Option("--scale", help="Scale of the images to include; repeatable.")] = None,
    models: Annotated[list[str] | None, Option("--model", help="Model to include; repeatable.")] = None,
    presets: Annotated[list[str] | None, Option("--preset", help="Preset to include; repeatable.")] = None,
    budgets: Annotated[list[float] | None, Option("--budget", help="Seconds of training to include; repeatable.")] = None,
    seeds: Annotated[list[int] | None, Option("--seed", help="Seed to include; repeatable.")] = None,
    plan_only: Annotated[bool, Option("--plan", help="List the trials without training.")] = False,
    as_json: console.Json = False,
) -> None:
    """Train frozen scenes under time budgets; write error, speed and memory as CSV and as an HTML report."""
    if context.invoked_subcommand is not None:
        return
    from koala3d.datasets.core.errors import UsageError
    from koala3d.reconstruct.bench import peers
    from koala3d.reconstruct.bench import suite as suites

    names, kinds, levels = (tuple(values or ()) for values in (scenes, models, presets))
    choice = suites.Choice(names, tuple(scales or ()), kinds, levels, tuple(budgets or ()), tuple(seeds or ()))
    trials = suites.plan(suite, choice)
    if plan_only:
        total = sum(trial.budget_s for trial in trials)
        lines = [trial.name for trial in trials] + [f"{len(trials)} trials, {total:.0f} s of training"]
        console.report({"trials": [vars(trial) for trial in trials], "training_s": total}, as_json=as_json, text="\n".join(lines))
        return
    if out is None:
        raise UsageError("give the folder of the benchmark: --out DIR")
    known = [] if peer is None else peers.read(peer)
    from koala3d.reconstruct.bench import report, runner

    result = runner.run(trials, out, data=data)
    written = report.write(out, known)
    missing = f", missing scenes: {', '.join(result['absent'])}" if result["absent"] else ""
    text = f"{result['done']} trials measured, {result['there']} measured before, {result['failed']} failed{missing}\n{written}"
    console.report({**result, "page": str(written)}, as_json=as_json, text=text)


@app.command("compare")
def compare_command(
    before: Annotated[Path, Argument(metavar="A", help="Folder of a benchmark.")],
    after: Annotated[Path, Argument(metavar="B", help="Folder of another benchmark.")],
    everything: Annotated[bool, Option("--all", help="Also list differences within the noise.")] = False,
    as_json: console.Json = False,
) -> None:
    """List the differences between two benchmarks that exceed the noise of repeated seeds."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.reconstruct.bench import compare
    from koala3d.reconstruct.bench.records import Records
    from koala3d.reconstruct.bench.runner import RECORDS

    sides = []
    for folder in (before, after):
        if not (folder / RECORDS).is_file():
            advice = "give a folder made by 'reconstruct bench'"
            raise UsageError("holds no benchmark", where=folder, why=f"it has no {RECORDS}", remedy=advice)
        sides.append(Records(folder / RECORDS).rows())
    found = compare.compare(*sides)
    if not found:
        raise UsageError("the two benchmarks have no trial in common", where=f"{before}, {after}")
    console.report(compare.summary(found), as_json=as_json, text=compare.text(found, everything=everything))
