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


def _side(name: str | None) -> str | None:
    """A side of the object's box, or none."""
    from datasets.core.errors import UsageError
    from reconstruct.output.mesh.isolation import SIDES

    if name is not None and name not in SIDES:
        raise UsageError(f"there is no side '{name}' of the box", where="--stands-on", remedy=f"one of {', '.join(SIDES)}")
    return name


RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="Folder made by 'reconstruct train'.")]
ModelName = Annotated[str, typer.Option("--model", help="Name of a model, see 'reconstruct models'.", autocompletion=_models)]
Preset = Annotated[
    str,
    typer.Option("--preset", help="fast: a workstation without GPU; paper: the published sizes.", autocompletion=_presets),
]
StandsOn = Annotated[
    str | None,
    typer.Option(
        "--stands-on",
        metavar="SIDE",
        callback=_side,
        help="The side of the box that the object stands on, e.g. -z: leave out of the mesh the table's top, and what reaches in "
        "through any other side.",
    ),
]
Seeds = Annotated[
    list[int] | None,
    typer.Option("--seed", min=0, help="Train with this seed; repeatable: tables then have means and standard deviations."),
]
