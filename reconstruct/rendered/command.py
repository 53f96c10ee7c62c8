"""`reconstruct scenes`."""

from pathlib import Path
from typing import Annotated

from typer import Option

from koala3d.datasets.core import console


def scenes(
    out: Annotated[Path, Option("--out", help="Folder to write; existing scenes in it are kept.")],
    names: Annotated[list[str] | None, Option("--scene", help="Scene to render; repeatable. Default: all ten.")] = None,
    size: Annotated[int, Option(min=16, max=2000, help="Width and height of the images in pixels.")] = 200,
    train: Annotated[int, Option(min=2, help="Number of training views.")] = 60,
    test: Annotated[int, Option(min=1, help="Number of test views.")] = 20,
    as_json: console.Json = False,
) -> None:
    """Render scenes whose shape and light are known exactly: five under distant light, five under near lamps."""
    from koala3d.datasets.core.errors import UsageError, nearest
    from koala3d.reconstruct.backend import configure_process
    from koala3d.reconstruct.rendered import make, stages

    for name in names or ():
        if name not in stages.STAGES:
            raise UsageError(f"there is no scene '{name}'", where="--scene", remedy=nearest(name, stages.STAGES))
    configure_process()
    chosen, written = names or list(stages.BENCHMARK), []
    with console.progress("rendering", len(chosen) * (train + test), "views") as bar:
        for name in chosen:
            bar.note(name)
            if make.provide(name, out / name, size=size, train=train, test=test, done=bar.advance):
                written.append(name)
    text = "\n".join(f"{out / name}{'' if name in written else '  (existed already)'}" for name in chosen)
    console.report({"scenes": [str(out / name) for name in chosen], "written": written}, as_json=as_json, text=text)
