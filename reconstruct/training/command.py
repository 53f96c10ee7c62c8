"""`reconstruct train`."""

from pathlib import Path
from typing import Annotated

import typer

from datasets.core import console
from reconstruct.options import ModelName, Preset


def train(
    out: Annotated[Path, typer.Option("--out", help="Folder of the run; must be new, unless --resume.")],
    scene: Annotated[
        str | None,
        typer.Argument(help="Scene folder: Koala (or koala/NAME), Blender, LLFF, nerfstudio or instant-ngp; not with --from."),
    ] = None,
    model: ModelName = "surfnerf",
    preset: Preset = "fast",
    budget: Annotated[float | None, typer.Option(help="Seconds of training proper; without it, train.steps steps.")] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Override a setting: key=value, e.g. scale=0.5; repeatable.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run in --out.")] = False,
    from_: Annotated[Path | None, typer.Option("--from", metavar="RUN", help="Begin with what a run has learned.")] = None,
    rays: Annotated[
        int | None, typer.Option(min=256, help="Rays per step; rate and steps follow by the linear scaling rule.")
    ] = None,
    finetune: Annotated[bool, typer.Option("--finetune", help="With --from: go on with the surface regularisers.")] = False,
    no_skip: Annotated[
        list[str] | None, typer.Option("--no-skip", metavar="NAME", help="Leave this in, needed or not; repeatable.")
    ] = None,
    tensorboard: Annotated[
        bool, typer.Option("--tensorboard", help="Write the log for TensorBoard too (extra 'tensorboard').")
    ] = False,
    coordinator: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", envvar="JAX_COORDINATOR_ADDRESS", help="Train in several processes: the first one's address."
        ),
    ] = None,
    processes: Annotated[
        int | None, typer.Option(min=1, envvar="JAX_NUM_PROCESSES", help="With --coordinator: how many there are.")
    ] = None,
    process: Annotated[
        int | None, typer.Option(min=0, envvar="JAX_PROCESS_ID", help="With --coordinator: which of them this is, from 0.")
    ] = None,
    as_json: console.Json = False,
) -> None:
    """Train a model on a scene's training views."""
    from datasets.core.errors import UsageError
    from datasets.formats import find, load_scene
    from reconstruct.backend import cache_compilations
    from reconstruct.models import finetuned, load_config
    from reconstruct.run import Run
    from reconstruct.training import distributed
    from reconstruct.training.batch import scaled
    from reconstruct.training.loop import train as run_training
    from reconstruct.training.skipping import record

    set_ = [*(set_ or ()), *record.forced(no_skip or ()), *(["train.tensorboard=true"] if tensorboard else [])]
    if (scene is None) == (from_ is None) or finetune != (from_ is not None):
        raise UsageError("give either a scene, or --from RUN --finetune")
    distributed.join(coordinator, processes, process)
    start_from = None if from_ is None else Run.open(from_)
    if start_from is not None:
        config, where, loaded = finetuned(start_from.config, set_), Path(start_from.scene_path), start_from.scene()
    else:
        config, where = load_config(model, preset, set_), find(str(scene))
        loaded = load_scene(where, measure=not resume)  # a run keeps the bounds that it began with
    config = config if rays is None else scaled(config, rays)
    cache_compilations()
    result = run_training(loaded, where, config, out, budget_s=budget, resume=resume, start_from=start_from)
    unneeded = "".join(f"  {line}\n" for line in record.left_out([record.Skip(**skip) for skip in result["skips"]]))
    skips = (
        f"left out, because this scene does not need it (every decision: {out / record.SKIPS}):\n{unneeded}" if unneeded else ""
    )
    known = {"training rays": result["psnr_train"], "unseen pixels": result["psnr_unseen"]}
    quality = ", ".join(f"{psnr:.2f} dB on {name}" for name, psnr in known.items() if psnr is not None)
    console.report(result, as_json=as_json, text=(
        f"{skips}trained {result['steps']} steps in {result['training_s']:.0f} s (and {result['preparation_s']:.0f} s to read, "
        f"{result['compilation_s']:.0f} s to compile): {quality}\n{out}"))  # fmt: skip
