"""Arguments and options that several commands of `reconstruct` share, worded once."""

from pathlib import Path
from typing import Annotated

import typer


def _models(incomplete: str) -> list[str]:
    """Completions for the shell."""
    from reconstruct.models import names

    return [name for name in names() if name.startswith(incomplete)]


def _presets(incomplete: str) -> list[str]:
    """Completions for the shell."""
    return [name for name in ("fast", "paper") if name.startswith(incomplete)]


def _side(name: str | None) -> str | None:
    """A side of the object's box, or none."""
    from datasets.core.errors import UsageError
    from reconstruct.output.mesh.isolation import SIDES

    if name is not None and name not in SIDES:
        raise UsageError(f"there is no side '{name}' of the box", where="--stands-on", remedy=f"one of {', '.join(SIDES)}")
    return name


RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="Folder made by 'reconstruct train'.")]
SceneName = Annotated[str, typer.Argument(metavar="SCENE", help="Scene folder, as for 'train'.")]
SceneNames = Annotated[list[str], typer.Argument(metavar="SCENE...", help="Scene folders, as for 'train'.")]
NewFolder = Annotated[Path, typer.Option("--out", help="Folder to write; must be new.")]
StudyFolder = Annotated[Path, typer.Option("--out", help="Folder to write; an interrupted study is resumed.")]
ModelName = Annotated[str, typer.Option("--model", help="Model, see 'reconstruct models'.", autocompletion=_models)]
Preset = Annotated[
    str,
    typer.Option("--preset", help="fast: a workstation without GPU; paper: the published sizes.", autocompletion=_presets),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a setting, see 'train --list-settings'; repeatable."),
]
Budget = Annotated[float | None, typer.Option("--budget", help="Seconds of training per run; default: train.steps steps.")]
Seeds = Annotated[
    list[int] | None,
    typer.Option("--seed", min=0, help="Seed to train with; repeatable: tables then show means and standard deviations."),
]
Split = Annotated[str, typer.Option("--split", help="Views to use: train, val or test.")]
CameraPath = Annotated[
    Path | None,
    typer.Option("--path", metavar="FILE.yaml", help="Camera path to render along, as written by 'reconstruct view'."),
]
StandsOn = Annotated[
    str | None,
    typer.Option(
        "--stands-on",
        metavar="SIDE",
        callback=_side,
        help="Side of the box that the object stands on, e.g. -z. Removes the table top, and whatever enters the box through "
        "other sides, from the mesh.",
    ),
]
