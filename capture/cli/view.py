"""The command `view`: a trajectory or a recording in the browser."""

from pathlib import Path
from typing import Annotated

from typer import Argument

from koala3d.capture.cli.options import RigName, Settings
from koala3d.datasets.core import console


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
