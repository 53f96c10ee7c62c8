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


RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="Folder made by 'reconstruct train'.")]
SceneName = Annotated[str, typer.Argument(metavar="SCENE", help="Scene folder, as for 'train'.")]
SceneNames = Annotated[list[str], typer.Argument(metavar="SCENE...", help="Scene folders, as for 'train'.")]
NewFolder = Annotated[Path, typer.Option("--out", help="Folder to write; must be new.")]
StudyFolder = Annotated[Path, typer.Option("--out", help="Folder to write; an interrupted study is resumed.")]
ModelName = Annotated[str, typer.Option("--model", help="Model, see 'reconstruct models'.", autocompletion=_models)]
Preset = Annotated[
    str, typer.Option("--preset", help="fast: a workstation without GPU; paper: the published sizes.", autocompletion=_presets)
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
