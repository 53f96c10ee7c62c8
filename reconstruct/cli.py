"""The `reconstruct` command. Commands are defined beside the code that they call and registered here."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from koala3d.datasets.core import console
from koala3d.reconstruct import train_command
from koala3d.reconstruct.asset import command as asset_command
from koala3d.reconstruct.diagnosis import command as diagnosis_command
from koala3d.reconstruct.experiments import commands as experiment_commands
from koala3d.reconstruct.options import Preset
from koala3d.reconstruct.output import commands as output_commands
from koala3d.reconstruct.output.shape import command as shape_command
from koala3d.reconstruct.rendered import command as scenes_command
from koala3d.reconstruct.series import command as series_command
from koala3d.reconstruct.splats import command as splats_command

app = console.make_app("reconstruct", "Train Surf-NeRF on a scene, evaluate it, and export images and geometry.")


def models(preset: Preset = "fast", as_json: console.Json = False) -> None:
    """List the models: encoding, appearance and regularisers under the chosen preset."""
    from koala3d.reconstruct.listing import models_text
    from koala3d.reconstruct.models import overview

    rows = overview(preset)
    console.report({"models": rows}, as_json=as_json, text=models_text(rows))


def backend(as_json: console.Json = False) -> None:
    """Say what training will run on, and with which kernels."""
    from koala3d.reconstruct.device import found

    about = found()
    console.report(about, as_json=as_json, text=str(about["text"]))


def view(
    path: Annotated[
        Path, Argument(metavar="RUN|SCENE|SERIES", help="Run, finished or still training; a scene; or the folder of a series.")
    ],
    mesh: Annotated[Path | None, Option(metavar="FILE.ply", help="Mesh to overlay, written by 'reconstruct mesh'.")] = None,
    asset: Annotated[
        Path | None, Option(metavar="FILE.glb", help="Asset to show beside the model, written by 'reconstruct asset'.")
    ] = None,
    light: Annotated[Path | None, Option(metavar="FILE.exr", help="Light of the asset; the page turns it.")] = None,
    port: console.Port = 8080,
    as_json: console.Json = False,
) -> None:
    """Explore a run in the browser, during training or afterwards, or see how far a series is."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.page import open_page
    from koala3d.reconstruct.backend import configure_process
    from koala3d.reconstruct.run import RUN, Run
    from koala3d.reconstruct.series.table import TABLE

    if (asset is None) != (light is None):
        remedy = "reconstruct asset RUN --out FILE.glb --light FILE.exr writes both"
        raise UsageError("an asset is shown under its light: give both", where="--asset, --light", remedy=remedy)
    if asset is not None and not (path / RUN).is_file():
        raise UsageError("an asset is shown beside the model of a run, and this is a scene", where=path, remedy="give the run")
    if (path / TABLE).is_file():
        return _series(path, port, as_json)
    configure_process()
    with open_page(path.name, port) as page:
        if (path / RUN).is_file():
            from koala3d.reconstruct.page.run_page import show
            from koala3d.reconstruct.page.wipe import lit_asset

            lit = lit_asset(asset, light) if asset is not None and light is not None else None
            show(page, Run.open(path), mesh=mesh, asset=lit)
        else:
            from koala3d.datasets.formats import load_scene
            from koala3d.datasets.reports.page.view import show as show_scene

            show_scene(page, path, load_scene(path), quick=True)
        console.report({"url": page.url, "path": str(path)}, as_json=as_json, text=f"{page.url} shows {path}; Ctrl-C ends it")
        page.serve()


def _series(folder: Path, port: int, as_json: bool) -> None:
    """Show the page of a series until Ctrl-C."""
    import time
    from contextlib import suppress

    from koala3d.reconstruct.page.series_page import served

    with served(folder, port) as url, suppress(KeyboardInterrupt):
        console.report({"url": url, "path": str(folder)}, as_json=as_json, text=f"{url} shows {folder}; Ctrl-C ends it")
        while True:
            time.sleep(1)


COMMANDS = {
    console.MAIN: (
        train_command.train,
        output_commands.eval_command,
        output_commands.mesh,
        asset_command.asset,
        splats_command.splats,
        series_command.series,
    ),
    console.LOOK: (view, output_commands.report, output_commands.render, asset_command.light),
    console.CHECK: (diagnosis_command.diagnose, shape_command.compare_shape, models, backend),
    console.STUDY: (experiment_commands.sweep, experiment_commands.table, scenes_command.scenes),
}
for _panel, _commands in COMMANDS.items():
    for _command in _commands:
        app.command(_command.__name__.removesuffix("_command").replace("_", "-"), panel=_panel)(_command)


def main() -> None:
    """Entry point."""
    console.run(app)


if __name__ == "__main__":
    main()
