"""The command `doctor`: says whether a recording can begin."""

from pathlib import Path
from typing import Annotated

from typer import Exit, Option

from koala3d.capture.cli.options import Ignore, RigName, Settings
from koala3d.datasets.core import console


def doctor(
    rig: RigName = "sim",
    out: Annotated[Path, Option(metavar="FOLDER", help="Where recordings will be: the disk whose free space is shown.")] = Path(),
    seconds: Annotated[float, Option(min=0.1, max=600, help="How long the network is watched.")] = 5.0,
    pictures: Annotated[
        Path | None,
        Option(
            "--pictures",
            metavar="TRAJECTORY",
            help="Also take pictures with these settings, and check that the camera's driver keeps its contract.",
        ),
    ] = None,
    settings: Settings = None,
    ignore: Ignore = None,
    as_json: console.Json = False,
) -> None:
    """Ask arm, camera and computer whether a recording can begin: a table of ok, wrong and unknown, with remedies.

    Nothing moves, nothing at the pendant is changed, and every setting of the camera that is tried is put back.

    The exit status is 1 if a line is wrong.
    """
    from koala3d import configs
    from koala3d.capture.doctor import acceptance
    from koala3d.capture.doctor.examine import examine
    from koala3d.capture.doctor.lines import Verdict, ignoring, table
    from koala3d.capture.rig.controllers import controller_of, host_of
    from koala3d.capture.rig.links import store_links
    from koala3d.capture.rig.naming import describe, is_simulated

    description = describe(rig)
    with controller_of(rig, description) as controller:
        host = host_of(description, controller)
        lines = examine(description, host, out, simulated=controller is not None, seconds=seconds)
        kept = store_links(rig, description, host)
    if not is_simulated(rig, description):
        lines.append(acceptance.check(configs.find("rigs", rig)))
    if pictures is not None:
        from koala3d.capture.doctor.driver import check_driver
        from koala3d.capture.model.trajectory import load_trajectory

        lines += check_driver(rig, load_trajectory(pictures, overrides=settings))
    lines = ignoring(lines, ignore or ())
    found = [
        {"name": line.name, "verdict": line.verdict, "found": line.found, "remedy": line.remedy, "blocks": line.blocks}
        for line in lines
    ]
    words = table(lines) if kept is None else f"{table(lines)}\nthe links of this arm are kept in {kept} for 'capture plan'"
    console.report({"rig": rig, "lines": found, "links": kept}, as_json=as_json, text=words)
    if any(line.verdict is Verdict.WRONG for line in lines):
        raise Exit(1)
