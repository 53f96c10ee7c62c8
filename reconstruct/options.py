"""Arguments and options that several commands of `reconstruct` have."""

from pathlib import Path
from typing import Annotated

import typer


def _models(incomplete: str) -> list[str]:
    """For the shell."""
    from reconstruct.models import names

    return [name for name in names() if name.startswith(incomplete)]


def _presets(incomplete: str) -> list[str]:
    """For the shell."""
    return [name for name in ("fast", "paper") if name.startswith(incomplete)]


RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="Folder made by 'reconstruct train'.")]
ModelName = Annotated[str, typer.Option("--model", help="Name of a model, see 'reconstruct models'.", autocompletion=_models)]
Preset = Annotated[
    str,
    typer.Option("--preset", help="fast: a workstation without GPU; paper: the published sizes.", autocompletion=_presets),
]
