"""The command that says whether a recording can begin."""

from pathlib import Path
from typing import Annotated

from typer import Exit, Option

from capture.options import RigName
from datasets.core import console


def doctor(
    rig: RigName = "sim",
    out: Annotated[Path, Option(metavar="FOLDER", help="Where recordings will be: the disk whose free space is shown.")] = Path(),
    as_json: console.Json = False,
) -> None:
    """Ask arm and computer whether a recording can begin: a table of ok, wrong and unknown, with remedies. Nothing moves.

    The exit status is 1 where a line is wrong.
    """
    from capture.doctor.examine import Place, examine
    from capture.doctor.lines import Verdict, table
    from capture.rig.opening import controller_of, describe

    description = describe(rig)
    with controller_of(rig, description) as controller:
        host = description.robot.host if controller is None else controller.host
        lines = examine(description, host, Place(out), simulated=controller is not None)
    found = [
        {"name": line.name, "verdict": line.verdict, "found": line.found, "remedy": line.remedy, "blocks": line.blocks}
        for line in lines
    ]
    console.report({"rig": rig, "lines": found}, as_json=as_json, text=table(lines))
    if any(line.verdict is Verdict.WRONG for line in lines):
        raise Exit(1)
