"""The commands below `reconstruct bench`; `reconstruct.cli` registers them."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Context, Option, Typer

from koala3d.datasets.core import console
from koala3d.reconstruct.bench.asset.command import asset_command
from koala3d.reconstruct.bench.gpu.command import gpu_command
from koala3d.reconstruct.options import ModelName, Settings

app = Typer(help="Measure run time against error.", rich_markup_mode=None, invoke_without_command=True)

app.command("gpu")(gpu_command)
app.command("asset")(asset_command)


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


@app.command("machine")
def machine_command(
    model: ModelName = "surfnerf",
    limits_only: Annotated[bool, Option("--limits", help="Measure the machine only, no kernels.")] = False,
    as_json: console.Json = False,
) -> None:
    """Measure this machine's limits, and how close each kernel of a training step comes to them."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.reconstruct.bench import context
    from koala3d.reconstruct.bench.cost import kernels, machine
    from koala3d.reconstruct.models import load_config
    from koala3d.reconstruct.sampling.create import sampler_type

    config = load_config(model, "fast")
    if not sampler_type(config.sampler).rules_out_space:
        raise UsageError("kernels cannot be measured", where=model, why="only models with an occupancy grid are supported")
    with console.progress("measuring", 1 if limits_only else 13, "kernels") as bar:
        limits = machine.limits()
        bar.advance()
        measured = [] if limits_only else kernels.rows(kernels.Bench.of(config).kernels(lambda name: bar.advance()), limits)
    about = context.describe()
    head = f"{about['machine']}, {about['cores']} cores, load {about['load']}, jax {about['jax']}, commit {about['commit']}"
    text = "\n".join([head, machine.text(limits), *(["", kernels.text(measured)] if measured else [])])
    console.report({**about, "limits": [vars(limit) for limit in limits], "kernels": measured}, as_json=as_json, text=text)


@app.command("scenes")
def scenes_command(
    out: Annotated[Path, Option("--out", help="Folder to write; existing scenes in it are kept.")],
    names: Annotated[list[str] | None, Option("--scene", help="Scene to render; repeatable. Default: all ten.")] = None,
    size: Annotated[int, Option(min=16, max=2000, help="Width and height of the images in pixels.")] = 200,
    train: Annotated[int, Option(min=2, help="Number of training views.")] = 60,
    test: Annotated[int, Option(min=1, help="Number of test views.")] = 20,
    layout: Annotated[str, Option("--format", help="Format of the folders: koala, blender or llff.")] = "koala",
    as_json: console.Json = False,
) -> None:
    """Render scenes whose shape and light are known exactly: five under distant light, five under near lamps."""
    from koala3d.datasets.core.errors import UsageError, nearest
    from koala3d.reconstruct.backend import cache_compilations
    from koala3d.reconstruct.bench.scenes import make, stages

    if layout not in (layouts := ("koala", "blender", "llff")):
        raise UsageError(f"scenes are not written as '{layout}'", where="--format", remedy=nearest(layout, layouts))
    for name in names or ():
        if name not in stages.STAGES:
            raise UsageError(f"there is no scene '{name}'", where="--scene", remedy=nearest(name, stages.STAGES))
    cache_compilations()
    chosen, written = names or list(stages.BENCHMARK), []
    with console.progress("rendering", len(chosen) * (train + test), "views") as bar:
        for name in chosen:
            bar.note(name)
            if make.provide(name, out / name, size=size, train=train, test=test, format=layout, done=bar.advance):
                written.append(name)
    text = "\n".join(f"{out / name}{'' if name in written else '  (existed already)'}" for name in chosen)
    console.report({"scenes": [str(out / name) for name in chosen], "written": written}, as_json=as_json, text=text)


@app.command("surfaces")
def surfaces_command(
    name: Annotated[str, Argument(metavar="SCENE", help="Name of a rendered scene.")],
    made_in: Annotated[
        Path, Option("--in", help="Folder that `reconstruct bench scenes` wrote; the scene is made if it is missing.")
    ],
    model: ModelName = "surfnerf",
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Train a rendered scene, and count on the way how many first surfaces are where the surface is, by each rule."""
    from koala3d.datasets.core.errors import UsageError, nearest
    from koala3d.datasets.formats import load_scene
    from koala3d.reconstruct.backend import cache_compilations
    from koala3d.reconstruct.bench import first_surfaces
    from koala3d.reconstruct.bench.scenes import make, stages
    from koala3d.reconstruct.models import load_config

    if name not in stages.STAGES:
        raise UsageError(f"there is no scene '{name}'", remedy=nearest(name, stages.STAGES))
    cache_compilations()
    make.provide(name, made_in / name)
    config = load_config(model, "fast", settings or [])
    found = first_surfaces.watch(load_scene(made_in / name), made_in / name, stages.STAGES[name].tracer(), config)
    console.report({"surfaces": [vars(seen) for seen in found]}, as_json=as_json, text=first_surfaces.table(found))
