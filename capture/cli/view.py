"""Commands for a person to look at: view, report; and the page of a running capture. They import pages when they run."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from koala3d.capture.cli.options import Recorded, RigName, Settings
from koala3d.datasets.core import console

if TYPE_CHECKING:
    from koala3d.capture.model.carrier import Mount
    from koala3d.capture.model.trajectory import Trajectory
    from koala3d.capture.planning import PlannedView


def view(
    path: Annotated[
        Path, Argument(metavar="TRAJECTORY|RECORDING", help="Name or file of a trajectory, or folder of a recording.")
    ],
    rig: RigName = "sim",
    port: console.Port = 8080,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Show a trajectory or a recording in the browser: arm, views, obstacles, and the session over time."""
    from koala3d.capture.page.view import show
    from koala3d.capture.rig.naming import describe
    from koala3d.datasets.page import open_page

    with open_page(path.stem, port) as page:
        shown = show(page, path, describe(rig), overrides=settings)
        blocked = f", {shown['blocked']} cannot be taken" if shown["blocked"] else ""
        text = f"{page.url} shows {shown['name']}, {shown['views']} views{blocked}; Ctrl-C ends it"
        console.report({"url": page.url, **shown}, as_json=as_json, text=text)
        page.serve()


def report(
    recording: Recorded,
    out: Annotated[Path, Option(metavar="PAGE.html", help="New page to write.")],
    as_json: console.Json = False,
) -> None:
    """Write an HTML report of a recording: findings, exposure, sharpness and joints over time, every picture."""
    from koala3d.capture.page.report import write

    with console.progress("reading", 1, "pictures") as shown:
        findings = write(recording, out, made_by=console.command_line(), done=shown.show)
    wrong = sum(not finding.note for finding in findings)
    console.report({"out": str(out), "findings": wrong}, as_json=as_json, text=f"{wrong} findings\n{out}")


@contextmanager
def watched(out: Path, session: "Trajectory", mount: "Mount", planned: "list[PlannedView]", port: int) -> Iterator[None]:
    """A page that shows a recording while it is made. Its stop button does what Ctrl-C does."""
    from koala3d.capture.page.view import watch
    from koala3d.datasets.page import open_page

    with open_page(session.name, port) as page:
        watch(page, out, session, mount, planned, stop=lambda: os.kill(os.getpid(), signal.SIGINT))
        console.hint(f"{page.url} shows the session")
        yield
