"""The commands below `reconstruct bench`; `reconstruct.cli` registers them."""

from pathlib import Path
from typing import Annotated

import typer

from datasets import console

app = typer.Typer(help="Measure run time against error.", no_args_is_help=True, rich_markup_mode=None)


@app.command("scenes")
def scenes_command(
    out: Annotated[Path, typer.Option("--out", help="Folder to write the scenes into; those that are there already are kept.")],
    names: Annotated[list[str] | None, typer.Option("--scene", help="Only this one; repeatable.")] = None,
    size: Annotated[int, typer.Option(min=16, max=2000, help="Pixels of a picture's side.")] = 200,
    train: Annotated[int, typer.Option(min=2, help="Views to train on.")] = 60,
    test: Annotated[int, typer.Option(min=1, help="Views to measure.")] = 20,
    as_json: console.Json = False,
) -> None:
    """Make the shiny scenes whose shape and light are known exactly."""
    from datasets.errors import Misuse, nearest
    from reconstruct.backend import cache_compilations
    from reconstruct.bench import scenes, shiny

    for name in names or ():
        if name not in shiny.SCENES:
            raise Misuse(f"there is no scene '{name}'", where="--scene", remedy=nearest(name, shiny.SCENES))
    cache_compilations()
    chosen, written = names or list(shiny.SCENES), []
    with console.progress("rendering", len(chosen) * (train + test), "views") as shown:
        for name in chosen:
            shown.note(name)
            if scenes.provide(name, out / name, size=size, train=train, test=test, done=shown.advance):
                written.append(name)
    text = "\n".join(f"{out / name}{'' if name in written else '  (was there)'}" for name in chosen)
    console.report({"scenes": [str(out / name) for name in chosen], "written": written}, as_json=as_json, text=text)
