"""`reconstruct train`."""

from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from koala3d.datasets.core import console
from koala3d.datasets.core.options import Rerun
from koala3d.reconstruct.options import Budget, ModelName, Preset, Settings

START, SPEED, MACHINES = "Start", "Speed", "Several machines"
"""Panels of the command's help."""
From = Annotated[
    Path | None,
    Option("--from", metavar="RUN", help="Run whose weights to start from; its configuration is used.", rich_help_panel=START),
]
Finetune = Annotated[
    bool, Option("--finetune", help="With --from: train on, on its scene, with the surface regularisers.", rich_help_panel=START)
]
Rays = Annotated[
    int | None, Option(min=256, help="Rays per step; learning rate and steps follow by linear scaling.", rich_help_panel=SPEED)
]
NoSkip = Annotated[
    list[str] | None,
    Option("--no-skip", metavar="NAME", help="Never skip this; repeatable, see docs/skipping.md.", rich_help_panel=SPEED),
]
Coordinator = Annotated[
    str | None,
    Option(metavar="HOST:PORT", envvar="JAX_COORDINATOR_ADDRESS", help="Address of the first process.", rich_help_panel=MACHINES),
]
Processes = Annotated[
    int | None, Option(min=1, envvar="JAX_NUM_PROCESSES", help="Number of processes.", rich_help_panel=MACHINES)
]
Process = Annotated[
    int | None, Option(min=0, envvar="JAX_PROCESS_ID", help="Index of this process, from 0.", rich_help_panel=MACHINES)
]


def train(
    scene: Annotated[
        str | None,
        Argument(help="Scene folder: Koala (or koala/NAME), Blender, LLFF, nerfstudio or instant-ngp; not with --finetune."),
    ] = None,
    out: Annotated[Path | None, Option("--out", help="Folder to write; must be new unless --resume is given.")] = None,
    model: ModelName = "surfnerf",
    preset: Preset = "fast",
    budget: Budget = None,
    set_: Settings = None,
    list_settings: Annotated[
        bool, Option("--list-settings", help="List every --set key with type, default and meaning.")
    ] = False,
    resume: Annotated[bool, Option("--resume", help="Resume the run in --out.", rich_help_panel=START)] = False,
    from_: From = None,
    finetune: Finetune = False,
    rays: Rays = None,
    no_skip: NoSkip = None,
    coordinator: Coordinator = None,
    processes: Processes = None,
    process: Process = None,
    rerun: Rerun = None,
    as_json: console.Json = False,
) -> None:
    """Train a model on the training views of a scene."""
    from koala3d.datasets.reports import rerun_file
    from koala3d.reconstruct.backend import configure_process
    from koala3d.reconstruct.page import rerun_training
    from koala3d.reconstruct.run import RUN
    from koala3d.reconstruct.training import distributed
    from koala3d.reconstruct.training.decisions import record
    from koala3d.reconstruct.training.loop import train as run_training
    from koala3d.reconstruct.training.ray_count import scaled

    set_ = [*(set_ or ()), *record.forced(no_skip or ())]
    if list_settings:
        return _list_settings(model, preset, set_, as_json)
    out = _agreed(scene, from_, finetune, out)
    rerun_file.require(rerun)
    distributed.join(coordinator, processes, process)
    config, where, loaded, start_from = _inputs(scene, from_, model, preset, set_, resume and (out / RUN).is_file())
    config = config if rays is None else scaled(config, rays)
    configure_process()
    series = start_from is not None and not finetune
    with rerun_training.watcher(rerun if distributed.writes() else None, loaded) as watch:
        options = {"budget_s": budget, "resume": resume, "start_from": start_from, "series": series, "watch": watch}
        result = run_training(loaded, where, config, out, **options)
    console.report(result, as_json=as_json, text=_summary(result, out))


def _agreed(scene: str | None, from_: Path | None, finetune: bool, out: Path | None) -> Path:
    """The folder of the run. Raises UsageError where something is missing or contradicts something else."""
    from koala3d.datasets.core.errors import UsageError

    if (scene is None) != finetune or (finetune and from_ is None):
        remedy = "with a scene, --from RUN begins with its weights"
        raise UsageError("give either a scene, or --from RUN --finetune", remedy=remedy)
    if out is None:
        raise UsageError("give the folder of the run: --out DIR")
    return out


def _list_settings(model: str, preset: str, overrides: list[str], as_json: bool) -> None:
    from koala3d.reconstruct import listing
    from koala3d.reconstruct.models import load_config

    rows = listing.settings(load_config(model, preset, overrides))
    console.report({"settings": rows}, as_json=as_json, text=listing.settings_text(rows))


def _inputs(scene: str | None, from_: Path | None, model: str, preset: str, overrides: list[str], begun: bool) -> Any:
    """Configuration, path of the scene, the scene, and the run to start from (or None)."""
    from koala3d.datasets.formats import find, load_scene
    from koala3d.reconstruct.models import changed, finetuned, load_config
    from koala3d.reconstruct.run import Run
    from koala3d.reconstruct.training.beginning.series import require_model

    run = None if from_ is None else Run.open(from_)
    if run is not None and scene is None:
        return finetuned(run.config, overrides), Path(run.scene_path), run.scene(), run
    if run is not None:
        require_model(run, model, preset)
        console.hint(f"begins with the weights of {from_}: model {run.config.model}, preset {run.config.preset}")
    config, where = load_config(model, preset, overrides) if run is None else changed(run.config, overrides), find(str(scene))
    return config, where, load_scene(where, measure=not begun), run  # a run keeps its bounds


def _summary(result: dict[str, Any], out: Path) -> str:
    """Skips, time and quality of a finished training."""
    from koala3d.reconstruct.training.decisions import record
    from koala3d.reconstruct.training.decisions.skip import Skip

    skips = [Skip(**skip) for skip in result["skips"]]
    skipped = "".join(f"  {line}\n" for line in record.left_out(skips))
    if skipped:
        skipped = f"skipped, because this scene does not need it (every decision: {out / record.SKIPS}):\n{skipped}"
    beside = "".join(f"learned beside the model: {line}\n" for line in record.learned(skips))
    known = {"training rays": result["psnr_train"], "test views": result["psnr_unseen"]}
    quality = ", ".join(f"{psnr:.2f} dB on {name}" for name, psnr in known.items() if psnr is not None)
    preparation, compilation = result["preparation_s"], result["compilation_s"]
    corrected = ", a number that was corrected on the way" if result["steps_corrected"] else ""
    return (
        f"{skipped}{beside}trained {result['steps']} steps{corrected} in {result['training_s']:.0f} s "
        f"(plus {preparation:.0f} s to read, {compilation:.0f} s to compile): {quality}\n{out}"
    )
