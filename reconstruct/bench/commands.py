"""The commands below `reconstruct bench`; `reconstruct.cli` registers them."""

from pathlib import Path
from typing import Annotated

import typer

from datasets.core import console

app = typer.Typer(help="Measure run time against error.", rich_markup_mode=None, invoke_without_command=True)


@app.callback()
def bench_command(
    context: typer.Context,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the benchmark; one that was broken off is gone on with.")
    ] = None,
    suite: Annotated[str, typer.Option(help="quick: ten minutes on two cores. full: most of a day.")] = "quick",
    peer: Annotated[Path | None, typer.Option(metavar="CSV", help="What other programs reach, to be drawn as well.")] = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder that holds lego400 and mold_gold_cape; else they are looked for.")
    ] = None,
    scenes: Annotated[list[str] | None, typer.Option("--scene", help="Only this scene; repeatable.")] = None,
    scales: Annotated[
        list[float] | None, typer.Option("--scale", help="Only pictures at this share of their size; repeatable.")
    ] = None,
    models: Annotated[list[str] | None, typer.Option("--model", help="Only this model, or one more; repeatable.")] = None,
    presets: Annotated[list[str] | None, typer.Option("--preset", help="Only this preset; repeatable.")] = None,
    budgets: Annotated[list[float] | None, typer.Option("--budget", help="Only this budget [s]; repeatable.")] = None,
    seeds: Annotated[list[int] | None, typer.Option("--seed", help="Only this seed, or one more; repeatable.")] = None,
    plan_only: Annotated[bool, typer.Option("--plan", help="List the trials; train nothing.")] = False,
    as_json: console.Json = False,
) -> None:
    """Train under time budgets on frozen scenes: error, work and memory as CSV and as a page."""
    if context.invoked_subcommand is not None:
        return
    from datasets.core.errors import UsageError
    from reconstruct.bench import peers
    from reconstruct.bench import suite as suites

    chosen = (scenes, scales, models, presets, budgets, seeds)
    choice = suites.Choice(*(tuple(values or ()) for values in chosen))
    trials = suites.plan(suite, choice)
    if plan_only:
        total = sum(trial.budget_s for trial in trials)
        lines = [trial.name for trial in trials] + [f"{len(trials)} trials, {total:.0f} s of training"]
        console.report({"trials": [vars(trial) for trial in trials], "training_s": total}, as_json=as_json, text="\n".join(lines))
        return
    if out is None:
        raise UsageError("give the folder of the benchmark: --out DIR")
    known = [] if peer is None else peers.read(peer)
    from reconstruct.bench import report, runner

    told = runner.run(trials, out, data=data)
    written = report.write(out, known)
    absent = f", scenes that are absent: {', '.join(told['absent'])}" if told["absent"] else ""
    console.report({**told, "page": str(written)}, as_json=as_json, text=(
        f"{told['done']} trials measured, {told['there']} had been there, {told['failed']} failed{absent}\n{written}"))  # fmt: skip


@app.command("compare")
def compare_command(
    before: Annotated[Path, typer.Argument(metavar="A", help="Folder of a benchmark.")],
    after: Annotated[Path, typer.Argument(metavar="B", help="Another one.")],
    everything: Annotated[bool, typer.Option("--all", help="Tell the differences within the noise too.")] = False,
    as_json: console.Json = False,
) -> None:
    """Say which differences between two benchmarks exceed the noise of repeated seeds."""
    from datasets.core.errors import UsageError
    from reconstruct.bench import compare
    from reconstruct.bench.records import Records
    from reconstruct.bench.runner import RECORDS

    sides = []
    for folder in (before, after):
        if not (folder / RECORDS).is_file():
            raise UsageError(
                "holds no benchmark", where=folder, why=f"no {RECORDS} in it", remedy="give a folder made by 'reconstruct bench'"
            )
        sides.append(Records(folder / RECORDS).rows())
    found = compare.compare(*sides)
    if not found:
        raise UsageError("the two have no trial in common", where=f"{before}, {after}")
    console.report(compare.summary(found), as_json=as_json, text=compare.text(found, everything=everything))


@app.command("machine")
def machine_command(
    model: Annotated[str, typer.Option(help="Model whose kernels are measured, see 'reconstruct models'.")] = "surfnerf",
    limits_only: Annotated[bool, typer.Option("--limits", help="Measure the machine alone, no kernels.")] = False,
    as_json: console.Json = False,
) -> None:
    """Measure what this machine allows, and how far each kernel of a training step is from it."""
    from datasets.core.errors import UsageError
    from reconstruct.bench import context
    from reconstruct.bench.cost import kernels, machine
    from reconstruct.models import load_config

    config = load_config(model, "fast")
    if config.sampler.kind != "occupancy":
        raise UsageError("is not taken apart", where=model, why="only models with an occupancy grid are")
    with console.progress("measuring", 1 if limits_only else 13, "kernels") as shown:
        limits = machine.limits()
        shown.advance()
        told = [] if limits_only else kernels.rows(kernels.Bench.of(config).kernels(lambda name: shown.advance()), limits)
    about = context.describe()
    head = f"{about['machine']}, {about['cores']} cores, load {about['load']}, jax {about['jax']}, commit {about['commit']}"
    text = "\n".join([head, machine.text(limits), *(["", kernels.text(told)] if told else [])])
    console.report({**about, "limits": [vars(limit) for limit in limits], "kernels": told}, as_json=as_json, text=text)


@app.command("scenes")
def scenes_command(
    out: Annotated[Path, typer.Option("--out", help="Folder to write the scenes into; those that are there already are kept.")],
    names: Annotated[list[str] | None, typer.Option("--scene", help="Only this one; repeatable.")] = None,
    size: Annotated[int, typer.Option(min=16, max=2000, help="Pixels of a picture's side.")] = 200,
    train: Annotated[int, typer.Option(min=2, help="Views to train on.")] = 60,
    test: Annotated[int, typer.Option(min=1, help="Views to measure.")] = 20,
    layout: Annotated[str, typer.Option("--format", help="Layout of the folders: koala, blender or llff.")] = "koala",
    as_json: console.Json = False,
) -> None:
    """Make the shiny scenes whose shape and light are known exactly."""
    from datasets.core.errors import UsageError, nearest
    from reconstruct.backend import cache_compilations
    from reconstruct.bench.scenes import make, shiny

    if layout not in (layouts := ("koala", "blender", "llff")):
        raise UsageError(f"scenes are not written as '{layout}'", where="--format", remedy=nearest(layout, layouts))
    for name in names or ():
        if name not in shiny.SCENES:
            raise UsageError(f"there is no scene '{name}'", where="--scene", remedy=nearest(name, shiny.SCENES))
    cache_compilations()
    chosen, written = names or list(shiny.SCENES), []
    with console.progress("rendering", len(chosen) * (train + test), "views") as shown:
        for name in chosen:
            shown.note(name)
            if make.provide(name, out / name, size=size, train=train, test=test, format=layout, done=shown.advance):
                written.append(name)
    text = "\n".join(f"{out / name}{'' if name in written else '  (was there)'}" for name in chosen)
    console.report({"scenes": [str(out / name) for name in chosen], "written": written}, as_json=as_json, text=text)
