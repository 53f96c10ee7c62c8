"""The `reconstruct` command."""

from pathlib import Path
from typing import Annotated

import typer

from datasets import console

app = console.make_app("reconstruct", "Train Surf-NeRF on a scene, measure it, and take pictures and geometry out of it.")

RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="Folder made by 'reconstruct train'.")]


@app.command()
def train(
    scene: Annotated[str, typer.Argument(help="Scene folder: Koala (or koala/NAME), Blender, LLFF, nerfstudio or instant-ngp.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the run; must be new, unless --resume.")],
    model: Annotated[str, typer.Option(help="Name of a file in configs/models.")] = "surfnerf",
    preset: Annotated[str, typer.Option(help="fast: a workstation without GPU; paper: the published sizes.")] = "fast",
    budget: Annotated[float | None, typer.Option(help="Seconds of training proper; without it, train.steps steps.")] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Override a setting: key=value, e.g. scale=0.5; repeatable.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run in --out.")] = False,
    as_json: console.Json = False,
) -> None:
    """Train a model on a scene's training views."""
    from datasets.formats import find, load_scene
    from reconstruct.backend import cache_compilations
    from reconstruct.config import load_config
    from reconstruct.train import train as run_training

    config = load_config(model, preset, set_)
    loaded = load_scene(scene)
    cache_compilations()
    result = run_training(loaded, find(scene), config, out, budget_s=budget, resume=resume)
    unseen = f", {result['psnr_unseen']:.2f} dB on unseen pixels" if result["psnr_unseen"] is not None else ""
    console.report(result, as_json=as_json, text=(
        f"trained {result['steps']} steps in {result['training_s']:.0f} s (and {result['preparation_s']:.0f} s to read, "
        f"{result['compilation_s']:.0f} s to compile): {result['psnr_train']:.2f} dB on training rays{unseen}\n{out}"))  # fmt: skip


@app.command("eval")
def eval_command(
    run: RunFolder,
    split: Annotated[str, typer.Option(help="Views to measure: train, val or test.")] = "test",
    as_json: console.Json = False,
) -> None:
    """Measure a run on its test views; writes RUN/metrics.json."""
    from reconstruct.backend import cache_compilations
    from reconstruct.evaluate import METRICS, evaluate, table

    cache_compilations()
    result = evaluate(run, split=split)
    console.report(result, as_json=as_json, text=f"{table(result)}\n{run / METRICS}")


def main() -> None:
    """Entry point."""
    console.run(app)


if __name__ == "__main__":
    main()
