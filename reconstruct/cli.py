"""The `reconstruct` command."""

from pathlib import Path
from typing import Annotated

import typer

from datasets.core import console
from reconstruct.bench import commands as bench_commands
from reconstruct.options import ModelName, Preset, RunFolder, Seeds, StandsOn
from reconstruct.training import command

app = console.make_app("reconstruct", "Train Surf-NeRF on a scene, measure it, and take pictures and geometry out of it.")
app.add_typer(bench_commands.app, name="bench")


app.command()(command.train)


@app.command("models")
def models_command(as_json: console.Json = False) -> None:
    """List the models: encoding, appearance, regularisers, what each is."""
    from reconstruct.models import overview

    rows = overview()
    lines = [("model", "encoding", "appearance", "regularisers", "about")]
    lines += [(r["name"], r["encoding"], r["appearance"], ", ".join(r["regularisers"]) or "-", r["about"]) for r in rows]
    widths = [max(len(line[column]) for line in lines) for column in range(4)]
    text = ["  ".join([*(cell.ljust(width) for cell, width in zip(line, widths, strict=False)), line[-1]]) for line in lines]
    console.report({"models": rows}, as_json=as_json, text="\n".join(text))


@app.command("table")
def table_command(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Measured runs.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write to FILE.md, FILE.csv or FILE.tex.")] = None,
    columns: Annotated[list[str] | None, typer.Option("--column", help="Figure to show; repeatable.")] = None,
    per_image: Annotated[bool, typer.Option("--per-image", help="A row per image instead of one per run.")] = False,
    as_json: console.Json = False,
) -> None:
    """Put the results of runs beside each other, in the paper's layout; runs that differ in their seed alone make one row."""
    from reconstruct.studies import results, results_table

    rows = results.rows_of_runs(runs, per_image=per_image)
    chosen = results_table.chosen_columns(rows, columns or ())
    if out is not None:
        results_table.write(rows, chosen, out)
    content = [{"scene": row.scene, "model": row.label, **row.content(chosen)} for row in rows]
    console.report(
        {"rows": content}, as_json=as_json, text=results_table.markdown(rows, chosen).rstrip() + (f"\n{out}" if out else "")
    )


@app.command("ablate")
def ablate_command(
    scene: Annotated[str, typer.Argument(help="Scene folder, as for 'train'.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the study; one that was broken off is gone on with.")],
    model: ModelName = "surfnerf",
    preset: Preset = "fast",
    budget: Annotated[float | None, typer.Option(help="Seconds of training per cell; without it, train.steps steps.")] = None,
    cells: Annotated[list[str] | None, typer.Option("--cell", help="Only this cell (beside the base); repeatable.")] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Override a setting in all cells: key=value; repeatable.")
    ] = None,
    seeds: Seeds = None,
    plan_only: Annotated[bool, typer.Option("--plan", help="List the cells and what they change; train nothing.")] = False,
    as_json: console.Json = False,
) -> None:
    """Train a model again and again with one thing changed, into one table and one figure."""
    from reconstruct.backend import cache_compilations
    from reconstruct.studies import ablate

    study = ablate.plan(scene, model, preset, set_ or (), budget, cells or (), seeds or ())
    if plan_only:
        text = "\n".join(f"{name:<20}{' '.join(changes) or '-'}" for name, changes in study.cells.items())
        return console.report({"cells": study.cells}, as_json=as_json, text=text)
    cache_compilations()
    result = ablate.run(study, out)
    console.report(result, as_json=as_json, text=f"{(out / 'table.md').read_text(encoding='utf-8').rstrip()}\n{out}")


@app.command("skips")
def skips_command(
    scenes: Annotated[list[str], typer.Argument(metavar="SCENE...", help="Scene folders, as for 'train'.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the comparison; one that was broken off is gone on with.")],
    names: Annotated[list[str] | None, typer.Option("--skip", metavar="NAME", help="Only this one; repeatable.")] = None,
    model: ModelName = "surfnerf",
    preset: Preset = "fast",
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Override a setting in all trainings: key=value; repeatable.")
    ] = None,
    as_json: console.Json = False,
) -> None:
    """Measure what each skip costs in error and saves in time: trains with it and without it."""
    from reconstruct.backend import cache_compilations
    from reconstruct.studies import skips

    cache_compilations()
    results = skips.run(scenes, out, names=names or (), model=model, preset=preset, overrides=set_ or ())
    console.report({"skips": skips.rows(results)}, as_json=as_json, text=f"{skips.markdown(results).rstrip()}\n{out}")


@app.command("sweep")
def sweep_command(
    out: Annotated[Path, typer.Option("--out", help="Folder of the sweep; one that was broken off is gone on with.")],
    scenes: Annotated[list[str], typer.Option("--scene", help="Scene folder, as for 'train'; repeatable.")],
    models: Annotated[list[str], typer.Option("--model", help="Name of a model; repeatable.")],
    preset: Preset = "fast",
    budget: Annotated[float | None, typer.Option(help="Seconds of training per run; without it, train.steps steps.")] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Override a setting in all runs: key=value; repeatable.")
    ] = None,
    seeds: Seeds = None,
    ray: Annotated[bool, typer.Option("--ray", help="Run as tasks of Ray (extra 'sweep').")] = False,
    address: Annotated[str | None, typer.Option("--address", help="Ray's cluster; without it, this machine.")] = None,
    as_json: console.Json = False,
) -> None:
    """Train and measure every model on every scene, into one table."""
    from reconstruct.studies import sweep

    jobs = sweep.jobs(scenes, models, preset, set_ or (), budget, out, seeds or ())
    result = sweep.run(jobs, out, use_ray=ray or address is not None, ray_address=address)
    console.report(result, as_json=as_json, text=f"{(out / 'table.md').read_text(encoding='utf-8').rstrip()}\n{out}")


@app.command("figures")
def figures_command(
    run: RunFolder,
    out: Annotated[Path, typer.Option("--out", help="Folder to write; must be new.")],
    steps: Annotated[int, typer.Option(min=1, help="Steps of the short training whose weights along a ray are drawn.")] = 600,
    as_json: console.Json = False,
) -> None:
    """Draw the figures of the paper's supplement from the code itself and a trained run."""
    from reconstruct.backend import cache_compilations
    from reconstruct.output.paper_figures import draw_all
    from reconstruct.output.trained_model import TrainedModel

    cache_compilations()
    result = draw_all(TrainedModel.open(run), out, steps=steps)
    console.report(result, as_json=as_json, text="\n".join(result["figures"]))


@app.command("eval")
def eval_command(
    run: Annotated[Path | None, typer.Argument(metavar="RUN", help="Folder made by 'reconstruct train'.")] = None,
    split: Annotated[str, typer.Option(help="Views to measure: train, val or test.")] = "test",
    renders: Annotated[Path | None, typer.Option(help="Instead of a run: pictures that another program rendered.")] = None,
    scene: Annotated[str | None, typer.Option(help="With --renders: the scene whose views they show.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.json", help="With --renders: write the figures there.")
    ] = None,
    align: Annotated[
        bool, typer.Option("--align", help="Measure also after each view's pose was aligned by itself to the model.")
    ] = False,
    lpips: Annotated[
        Path | None, typer.Option(metavar="WEIGHTS.npz", help="Measure LPIPS (AlexNet) too, with these weights; docs/numbers.md.")
    ] = None,
    stands_on: StandsOn = None,
    as_json: console.Json = False,
) -> None:
    """Measure a run on its test views (writes RUN/metrics.json), or renderings made elsewhere with the same ruler."""
    from datasets.core.errors import UsageError
    from datasets.formats import load_scene
    from reconstruct.backend import cache_compilations
    from reconstruct.output.evaluate import METRICS, evaluate, table
    from reconstruct.output.external_renderings import measure
    from reconstruct.output.lpips import Lpips
    from reconstruct.output.trained_model import TrainedModel

    perceptual = None if lpips is None else Lpips.load(lpips)
    if run is not None and renders is None and scene is None and out is None:
        cache_compilations()
        result = evaluate(TrainedModel.open(run), split=split, lpips=perceptual, align=align, stands_on=stands_on)
        where = run / METRICS
    elif run is None and renders is not None and scene is not None and not align and stands_on is None:
        result, where = measure(renders, load_scene(scene), split=split, out=out, lpips=perceptual), out
    else:
        raise UsageError("give either a run, or --renders DIR --scene SCENE")
    console.report(result, as_json=as_json, text=f"{table(result)}\n{where or ''}".rstrip())


@app.command("render")
def render_command(
    run: RunFolder,
    out: Annotated[Path, typer.Option("--out", help="Folder to write; must be new.")],
    split: Annotated[str, typer.Option(help="Views to render: train, val or test.")] = "test",
    path: Annotated[
        Path | None, typer.Option(help="Instead of views: the frames of a camera path, as 'reconstruct view' writes it.")
    ] = None,
    as_json: console.Json = False,
) -> None:
    """Render views: colour, its diffuse and specular part, normals, depth, opacity, roughness."""
    from datasets.core.files import refuse_existing
    from reconstruct.backend import cache_compilations
    from reconstruct.output import camera_path
    from reconstruct.output.export import render, render_along
    from reconstruct.output.trained_model import TrainedModel

    refuse_existing(out)
    along = None if path is None else camera_path.from_file(path)[0]
    cache_compilations()
    trained = TrainedModel.open(run)
    result = render(trained, out, split=split) if along is None else render_along(trained, along, out)
    console.report(result, as_json=as_json, text=f"{result['views']} views in {out}")


@app.command("view")
def view_command(
    path: Annotated[Path, typer.Argument(metavar="RUN|SCENE", help="Run, finished or under way; or a scene, to see it before.")],
    mesh: Annotated[
        Path | None, typer.Option(metavar="FILE.ply", help="Mesh to lay over it, as 'reconstruct mesh' writes it.")
    ] = None,
    port: console.Port = 8080,
    as_json: console.Json = False,
) -> None:
    """Fly through a run in the browser, while it trains and afterwards: colour, its parts, normals, depth, beside the photographs."""
    from datasets.page import open_page
    from reconstruct.backend import cache_compilations
    from reconstruct.run import RUN, Run

    cache_compilations()
    with open_page(path.name, port) as page:
        if (path / RUN).is_file():
            from reconstruct.page.run_page import show

            show(page, Run.open(path), mesh=mesh)
        else:
            from datasets.formats import load_scene
            from datasets.page.view import show as show_scene

            show_scene(page, path, load_scene(path), quick=True)
        console.report({"url": page.url, "path": str(path)}, as_json=as_json, text=f"{page.url} shows {path}; Ctrl-C ends it")
        page.serve()


@app.command("film")
def film_command(
    run: RunFolder,
    out: Annotated[Path, typer.Option("--out", metavar="FILE.mp4", help="Film to write.")],
    path: Annotated[
        Path | None, typer.Option(help="YAML file with fps, seconds and poses (position, target, up); without it, an orbit.")
    ] = None,
    frames: Annotated[int, typer.Option(min=1, help="Frames of the orbit.")] = 120,
    fps: Annotated[float, typer.Option(min=0.1, max=240, help="Frames per second of the orbit.")] = 30.0,
    shown: Annotated[
        list[str] | None,
        typer.Option("--channel", help="rgb, diffuse, specular, normals, depth_view, ...; repeatable, side by side."),
    ] = None,
    as_json: console.Json = False,
) -> None:
    """Film a run along an orbit or a camera path, as MP4."""
    from reconstruct.backend import cache_compilations
    from reconstruct.output import camera_path
    from reconstruct.output.film import film
    from reconstruct.output.trained_model import TrainedModel

    along = None if path is None else camera_path.from_file(path)
    cache_compilations()
    trained = TrainedModel.open(run)
    places, rate = along or (camera_path.orbit(trained.scene, frames), fps)
    result = film(trained, places, out, shown=shown or ("rgb",), fps=rate)
    console.report(result, as_json=as_json, text=f"{result['frames']} frames at {rate:g} per second\n{out}")


@app.command("mesh")
def mesh_command(
    run: RunFolder,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="FILE.ply, FILE.glb or FILE.obj to write.")],
    resolution: Annotated[
        int, typer.Option(min=16, max=768, help="Grid points along the longest side of the object's box.")
    ] = 256,
    level: Annotated[
        float, typer.Option(min=0.001, max=0.999, help="The surface is where 1/128 of the box absorbs this share of light.")
    ] = 0.5,
    watertight: Annotated[bool, typer.Option("--watertight", help="Close the surface where it leaves the box.")] = False,
    faces: Annotated[int | None, typer.Option(min=4, help="Simplify to about so many triangles.")] = None,
    points: Annotated[int | None, typer.Option(min=1, help="Write so many points on the surface instead (PLY).")] = None,
    stands_on: StandsOn = None,
    follow: Annotated[
        bool, typer.Option("--follow-normals/--density-only", help="Let the surface follow the predicted normals, or leave it.")
    ] = True,
    as_json: console.Json = False,
) -> None:
    """Take the object's surface out of a run, as a coloured triangle mesh or points in world coordinates."""
    from datasets.core.errors import UsageError
    from datasets.core.files import refuse_existing
    from reconstruct.backend import cache_compilations
    from reconstruct.output.mesh import extraction, files
    from reconstruct.output.trained_model import TrainedModel

    suffixes = files.SUFFIXES if points is None else (".ply",)
    if out.suffix.lower() not in suffixes:
        raise UsageError(f"{'meshes' if points is None else 'points'} are not written as '{out.suffix}'", where=out,
                     remedy=f"end --out in {', '.join(suffixes)}")  # fmt: skip
    refuse_existing(out)
    cache_compilations()
    trained = TrainedModel.open(run)
    surface = extraction.extract(
        trained, resolution=resolution, level=level, watertight=watertight, faces=faces, stands_on=stands_on, follow=follow
    )
    files.save(surface if points is None else files.points_on(surface, points), out)
    result, text = extraction.summary(surface, trained.scene)
    console.report({"out": str(out), **result}, as_json=as_json, text=f"{text}\n{out}")


@app.command("report")
def report_command(
    run: RunFolder,
    out: Annotated[Path, typer.Option("--out", help="Folder to write; must be new.")],
    calibration: Annotated[Path | None, typer.Option(help="Calibration file whose figures are to be shown too.")] = None,
    as_json: console.Json = False,
) -> None:
    """Write a page with results, pictures beside the truth and the error over time."""
    from datasets.core.files import refuse_existing
    from reconstruct.backend import cache_compilations
    from reconstruct.output.report import write
    from reconstruct.output.trained_model import TrainedModel

    refuse_existing(out)
    cache_compilations()
    result = write(TrainedModel.open(run), out, calibration=calibration)
    console.report(result, as_json=as_json, text=result["report"])


def main() -> None:
    """Entry point."""
    console.run(app)


if __name__ == "__main__":
    main()
