"""The command that compares shapes."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from koala3d.datasets.core import console
from koala3d.reconstruct.options import NewFolder
from koala3d.reconstruct.output.commands import StandsOn


def _by(name: str | None) -> str | None:
    """A way to align, or none."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.reconstruct.output.shape.alignment import BY

    if name is not None and name not in BY:
        raise UsageError(f"there is no way '{name}' to align", where="--align", remedy=f"one of {', '.join(BY)}")
    return name


def _unit(name: str) -> str:
    """A unit of length."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.reconstruct.output.shape.stated import UNITS

    if name not in UNITS:
        raise UsageError(f"there is no unit '{name}'", where="--unit", remedy=f"one of {', '.join(UNITS)}")
    return name


def compare_shape(
    first: Annotated[Path, Argument(metavar="A", help="Run, or mesh in metres: STL, OBJ, PLY or GLB.")],
    second: Annotated[Path, Argument(metavar="B", help="What A is compared with: run, mesh or drawing.")],
    out: NewFolder,
    tolerance: Annotated[float, Option(min=1e-9, max=1e3, metavar="METRES", help="Deviation up to which A is good.")] = 1e-3,
    align: Annotated[
        str | None,
        Option(
            metavar="base|icp|features",
            callback=_by,
            help="Leave A in place, move it from there, or place it where it fits. Default: the first that can be right.",
        ),
    ] = None,
    scale: Annotated[bool, Option("--scale", help="Remove the difference in size, which is estimated in any case.")] = False,
    unit: Annotated[str, Option(metavar="m|mm|cm|in", callback=_unit, help="Unit of B's file.")] = "m",
    stands_on: StandsOn = None,
    as_json: console.Json = False,
) -> None:
    """Compare a shape with another or with a drawing: deviation on the surface, and how certain it is."""
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.reconstruct.output.shape import files, stated
    from koala3d.reconstruct.output.shape.comparison import compare

    refuse_existing(out)
    one = stated.read(first, stands_on=stands_on)
    other = stated.read(second, unit=unit, stands_on=stands_on)  # type: ignore[arg-type]
    found = compare(one, other, tolerance=tolerance, by=align, scaled=scale)  # type: ignore[arg-type]
    result = files.write(found, out, console.command_line())
    console.report({"out": str(out), **result}, as_json=as_json, text=f"{files.summary(result)}\n{out}")
