"""`reconstruct series`."""

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from koala3d.datasets.core import console

WATCH, WHERE = "Watch", "Where"


def series(
    file: Annotated[Path, Argument(metavar="SERIES.yaml", help="Objects, what they share, and rules; see docs/series.md.")],
    out: Annotated[Path, Option("--out", help="Folder to write; an interrupted series in it is resumed.")],
    plan_only: Annotated[bool, Option("--plan", help="List the commands without running them.")] = False,
    watch: Annotated[
        Path | None,
        Option(metavar="FOLDER", help="Also take recordings that appear here, once they are complete.", rich_help_panel=WATCH),
    ] = None,
    idle: Annotated[
        float | None,
        Option(
            "--idle",
            min=0,
            metavar="SECONDS",
            help="End when nothing has happened for so long. Default: Ctrl-C.",
            rich_help_panel=WATCH,
        ),
    ] = None,
    ray: Annotated[bool, Option("--ray", help="Run as Ray tasks (extra 'sweep').", rich_help_panel=WHERE)] = False,
    address: Annotated[
        str | None, Option("--address", help="Ray cluster to use; default: this machine.", rich_help_panel=WHERE)
    ] = None,
    as_json: console.Json = False,
) -> None:
    """From many recordings or scenes to figures, meshes, reports and assets: a row for each on one page."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.reconstruct.series.file import read
    from koala3d.reconstruct.series.run import Shelf, run
    from koala3d.reconstruct.series.watch import Watch

    if watch is not None and not watch.is_dir():
        raise UsageError("there is no such folder", where=f"--watch {watch}", remedy="give the folder that recordings appear in")
    if idle is not None and watch is None:
        raise UsageError("--idle is for --watch", remedy="without it a series ends when everything is done")
    shelf = Shelf(read(file), out, None if watch is None else Watch(watch, idle))
    steps = [step for piece in shelf.pieces.values() for step in piece.steps]
    if plan_only:
        lines = [f"{'done  ' if step.done else '      '}{step.command}" for step in steps]
        text = "\n".join([f"in {shelf.series.folder}:", *lines])
        return console.report(
            {"steps": [{"command": step.command, "done": step.done} for step in steps]}, as_json=as_json, text=text
        )
    if ray or address is not None:
        from koala3d.reconstruct.experiments import on_ray  # Ray is optional

        run_all = partial(on_ray.run_all, address=address, shared=[shelf.out, *shelf.series.inputs])
    else:
        from koala3d.reconstruct.experiments.runner import run_all
    result = run(shelf, run_all)
    states = Counter(row["state"] for row in result["objects"])
    told = ", ".join(f"{count} {state}" for state, count in states.items())
    console.report(result, as_json=as_json, text=f"{told} of {len(result['objects'])} objects\n{result['page']}")
