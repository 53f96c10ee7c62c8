"""The command `datasets mask`; `datasets.cli` registers it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from koala3d.datasets.core import console, options
from koala3d.datasets.core.help import MAIN, App
from koala3d.datasets.core.options import DataRoot, Json, OutFolder, Port

if TYPE_CHECKING:
    from koala3d.datasets.formats.links import Extra
    from koala3d.datasets.scene import Scene
    from koala3d.datasets.segmentation.grow import Grower, Grown
    from koala3d.datasets.segmentation.space import Ball
    from koala3d.datasets.segmentation.strokes import Stroke

DOUBTFUL = 0.75
"""Agreement of a mask with the other views below which the view is named."""
MOST_NAMED = 5

Centre = Annotated[
    tuple[float, float, float, float] | None,
    typer.Option(
        "--ball",
        metavar="X Y Z RADIUS",
        help="Where the object is; by default where all cameras look, or the stated box if that is smaller.",
    ),
]
Strokes = Annotated[Path | None, typer.Option(metavar="FILE", help="Corrections, as --page writes them.")]
Mesh = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="The object's shape, where it stands in the scene's world and unit: masks are what it covers."
    ),
]
InPage = Annotated[bool, typer.Option("--page", help="Show the masks in the browser and correct them with a brush.")]


def add_to(app: App) -> None:
    """Register the command."""
    app.command(panel=MAIN)(mask)


def mask(
    scene: options.Scene,
    out: OutFolder,
    ball: Centre = None,
    strokes: Strokes = None,
    mesh: Mesh = None,
    page: InPage = False,
    port: Port = 8080,
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Write a scene with masks of its object, found where all views agree.

    Cameras should look at the object from all around, and it should differ from what is behind it in colour. Where its shape
    is known, --mesh needs neither."""
    from koala3d.datasets.building.build import extra_truth
    from koala3d.datasets.core import files
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.formats import find, load_scene
    from koala3d.datasets.segmentation import strokes as corrections
    from koala3d.datasets.segmentation.grow import Grower
    from koala3d.datasets.segmentation.write import write

    files.refuse_existing(out)
    if mesh is not None and (ball is not None or strokes is not None or page):
        raise UsageError("needs no --ball, --strokes or --page", where="--mesh", remedy="leave them out")
    loaded, extra = load_scene(scene, data_root=data_root), extra_truth(find(scene, data_root))
    if mesh is not None:
        _of_known_shape(loaded, mesh, out, extra, as_json)
        return
    drawn = corrections.read(strokes, (view.name for view in loaded.views)) if strokes is not None else []
    with console.progress("reading", len(loaded.views), "views") as shown:
        grower = Grower(loaded, _ball(ball), done=shown.advance)
    with console.progress("cutting", len(loaded.views), "cuts") as shown:
        found = grower.grow(drawn, done=shown.show)
    if not page:
        _refuse_nothing(found, scene)
    else:
        _serve(grower, found, drawn, out, extra, port, as_json)
    with console.progress("writing", len(loaded.views), "views") as shown:
        write(loaded, found.masks, drawn, out, extra=extra, done=shown.advance)
    doubtful = doubts(grower, found)
    lines = [
        f"{len(loaded.views)} masks written to {out}; they agree by {found.agreement.mean():.0%} with those of the other views"
    ]
    lines += [f"look at {name}: {share:.0%}" for name, share in list(doubtful.items())[:MOST_NAMED]]
    if doubtful:
        lines.append("correct them with a brush: --page, and a new --out")
    result = {"out": str(out), "views": len(loaded.views), "agreement": float(found.agreement.mean()), "doubtful": doubtful}
    console.report(result, as_json=as_json, text="\n".join(lines))


def _of_known_shape(scene: "Scene", mesh: Path, out: Path, extra: "Extra", as_json: bool) -> None:
    """Write the masks of a mesh; raises UsageError where it cannot be read, or most views do not see it."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.core.meshes import read_mesh
    from koala3d.datasets.segmentation.known_shape import silhouettes
    from koala3d.datasets.segmentation.write import write

    vertices, faces = read_mesh(mesh)
    with console.progress("drawing", len(scene.views), "views") as shown:
        masks = silhouettes(scene.views, vertices, faces, done=shown.advance)
    unseen = sum(not one.any() for one in masks)
    if 2 * unseen > len(masks):
        why = f"{unseen} of {len(masks)} views do not see it"
        raise UsageError(
            "the mesh is not where the views look", where=mesh, why=why, remedy="give it in the scene's world and unit"
        )
    with console.progress("writing", len(masks), "views") as shown:
        write(scene, masks, [], out, known_shape=True, extra=extra, done=shown.advance)
    covered = sum(one.mean() for one in masks) / len(masks)
    text = f"{len(masks)} masks written to {out}; the mesh covers {covered:.0%} of the pictures"
    console.report({"out": str(out), "views": len(masks), "unseen": unseen}, as_json=as_json, text=text)


def _refuse_nothing(found: "Grown", scene: str) -> None:
    """Raise DatasetError where most masks are empty."""
    from koala3d.datasets.core.errors import DatasetError

    if 2 * sum(not mask.any() for mask in found.masks) > len(found.masks):
        what, why = "no object on which the views agree", "most cameras do not look at it, or it has the colours behind it"
        raise DatasetError(what, where=scene, why=why, remedy="say where it is with --ball, or draw it with --page")


def doubts(grower: "Grower", found: "Grown") -> dict[str, float]:
    """Agreement of the views whose masks the others do not confirm, the worst first."""
    named = {view.name: float(share) for view, share in zip(grower.views, found.agreement, strict=True) if share < DOUBTFUL}
    return dict(sorted(named.items(), key=lambda one: one[1]))


def _serve(grower: "Grower", found: "Grown", drawn: list["Stroke"], out: Path, extra: "Extra", port: int, as_json: bool) -> None:
    from koala3d.datasets.page import open_page
    from koala3d.datasets.segmentation.page.brush import MaskPage

    with open_page(f"masks of {grower.scene.name}", port) as served:
        MaskPage(served, grower, found, drawn, out, extra)
        text = f"{served.url} shows the masks; nothing is written before 'write the scene' is pressed; Ctrl-C ends it"
        console.report({"url": served.url, "out": str(out)}, as_json=as_json, text=text)
        served.serve()


def _ball(given: tuple[float, float, float, float] | None) -> "Ball | None":
    import numpy as np

    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.segmentation.space import Ball

    if given is None:
        return None
    if not np.isfinite(given).all() or given[3] <= 0:
        raise UsageError(
            "is no ball", where="--ball", why=f"radius {given[3]}", remedy="four finite numbers, the radius above zero"
        )
    return Ball(np.array(given[:3]), given[3])
