"""Arguments and options that several commands of `reconstruct` share, worded once."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option


def _models(incomplete: str) -> list[str]:
    """Completions for the shell."""
    from koala3d.reconstruct.models import names

    return [name for name in names() if name.startswith(incomplete)]


def _presets(incomplete: str) -> list[str]:
    """Completions for the shell."""
    return [name for name in ("fast", "paper") if name.startswith(incomplete)]


RunFolder = Annotated[Path, Argument(metavar="RUN", help="Folder made by 'reconstruct train'.")]
NewFolder = Annotated[Path, Option("--out", help="Folder to write; must be new.")]
ModelName = Annotated[str, Option("--model", help="Model, see 'reconstruct models'.", autocompletion=_models)]
Preset = Annotated[
    str, Option("--preset", help="fast: a workstation without GPU; paper: the published sizes.", autocompletion=_presets)
]
Settings = Annotated[
    list[str] | None, Option("--set", metavar="KEY=VALUE", help="Override a setting, see 'train --list-settings'; repeatable.")
]
Budget = Annotated[
    float | None,
    Option("--budget", help="Seconds of training per run, turned into a number of steps; default: train.steps steps."),
]
