"""Commands for a trained run: eval, render, mesh, report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from koala3d.datasets.core import console
from koala3d.reconstruct.options import NewFolder, RunFolder

if TYPE_CHECKING:
    from koala3d.reconstruct.output.trained_model import TrainedModel


def _side(name: str | None) -> str | None:
    """A side of the object's box, or none."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.reconstruct.output.mesh.isolation import SIDES

    if name is not None and name not in SIDES:
        raise UsageError(f"there is no side '{name}' of the box", where="--stands-on", remedy=f"one of {', '.join(SIDES)}")
    return name


Split = Annotated[str, Option("--split", help="Views to use: train, val or test.")]
CameraPath = Annotated[
    Path | None, Option("--path", metavar="FILE.yaml", help="Camera path to render along, as written by 'reconstruct view'.")
]
_ON = "Side of the box that the object stands on, e.g. -z."
_REMOVES = "Removes the table top, and whatever enters the box through other sides, from the mesh."
StandsOn = Annotated[str | None, Option("--stands-on", metavar="SIDE", callback=_side, help=f"{_ON} {_REMOVES}")]


_ASSET = "Asset"


def eval_command(
    run: Annotated[Path | None, Argument(metavar="RUN", help="Folder made by 'reconstruct train'.")] = None,
    split: Split = "test",
    renders: Annotated[Path | None, Option(help="Folder of another program's images, to evaluate instead of a run.")] = None,
    scene: Annotated[str | None, Option(help="With --renders: scene that the images show.")] = None,
    out: Annotated[Path | None, Option("--out", metavar="FILE.json", help="With --renders: file to write.")] = None,
    align: Annotated[bool, Option("--align", help="Evaluate again after aligning the pose of each view to the model.")] = False,
    lpips: Annotated[
        Path | None, Option(metavar="WEIGHTS.npz", help="Compute LPIPS (AlexNet) with these weights, see docs/numbers.md.")
    ] = None,
    stands_on: StandsOn = None,
    asset: Annotated[
        Path | None,
        Option(
            metavar="FILE.glb", help="Compare the run's asset, rendered by Mitsuba, instead of the model.", rich_help_panel=_ASSET
        ),
    ] = None,
    light: Annotated[Path | None, Option(metavar="FILE.exr", help="Light around the asset.", rich_help_panel=_ASSET)] = None,
    paths: Annotated[int, Option(min=1, max=65536, help="Light paths per pixel.", rich_help_panel=_ASSET)] = 64,
    relit: Annotated[
        int | None,
        Option(
            min=0, metavar="NUMBER", help="Also in another studio's light (of 'reconstruct scenes' only).", rich_help_panel=_ASSET
        ),
    ] = None,
    show: Annotated[
        Path | None, Option(help="New folder: each view as photograph, model and asset side by side.", rich_help_panel=_ASSET)
    ] = None,
    as_json: console.Json = False,
) -> None:
    """Evaluate a run (writes RUN/metrics.json), its asset, or another program's images, on the test views."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.formats import load_scene
    from koala3d.reconstruct.output.evaluate import METRICS, evaluate, table
    from koala3d.reconstruct.output.external_renderings import measure
    from koala3d.reconstruct.output.lpips import Lpips

    if run is not None and asset is not None and light is not None:
        return _prove(run, asset, light, split, paths, relit, show, as_json)
    if (asset, light, relit, show) != (None, None, None, None):
        raise UsageError("an asset is compared with its run, under its light", remedy="give RUN, --asset and --light")
    perceptual = None if lpips is None else Lpips.load(lpips)
    if run is not None and renders is None and scene is None and out is None:
        result = evaluate(opened(run), split=split, lpips=perceptual, align=align, stands_on=stands_on)
        where = run / METRICS
    elif run is None and renders is not None and scene is not None and not align and stands_on is None:
        result, where = measure(renders, load_scene(scene), split=split, out=out, lpips=perceptual), out
    else:
        raise UsageError("give either a run, or --renders DIR --scene SCENE")
    console.report(result, as_json=as_json, text=f"{table(result)}\n{where or ''}".rstrip())


def _prove(
    run: Path, asset: Path, light: Path, split: str, paths: int, relit: int | None, show: Path | None, as_json: bool
) -> None:
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.reconstruct.output.proof import proof

    if show is not None:
        refuse_existing(show)
    found = proof.prove(opened(run), asset, light, split=split, paths=paths, relit=relit, out=show)
    places = "\n".join(str(path) for path in (run / proof.METRICS, show) if path is not None)
    console.report(found, as_json=as_json, text=f"{proof.text(found)}\n{places}")


_FILM = "Film"


def render(
    run: RunFolder,
    out: Annotated[Path, Option("--out", metavar="FOLDER|FILE.mp4", help="Folder of pictures, or film; must be new.")],
    split: Split = "test",
    path: CameraPath = None,
    frames: Annotated[
        int | None,
        Option(min=1, help="Without --path: frames of an orbit around the object. Default: 120.", rich_help_panel=_FILM),
    ] = None,
    fps: Annotated[
        float | None, Option(min=0.1, max=240, help="Without --path: frames per second. Default: 30.", rich_help_panel=_FILM)
    ] = None,
    shown: Annotated[
        list[str] | None,
        Option(
            "--channel", help="rgb, diffuse, specular, normals, depth_view, ...; repeatable, side by side.", rich_help_panel=_FILM
        ),
    ] = None,
    as_json: console.Json = False,
) -> None:
    """Render views, or the frames of a camera path, in all channels; or a film (MP4) along a path or an orbit."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.reconstruct.output import camera_path, export, film

    along = None if path is None else camera_path.from_file(path)
    if out.suffix.lower() != ".mp4":
        if (frames, fps, shown) != (None, None, None):
            raise UsageError("--frames, --fps and --channel are for films", where=out, remedy="end --out in .mp4")
        refuse_existing(out)
        trained = opened(run)
        result = export.render(trained, out, split=split) if along is None else export.render_along(trained, along[0], out)
        return console.report(result, as_json=as_json, text=f"{result['views']} views in {out}")
    trained = opened(run)
    poses, rate = along or (camera_path.orbit(trained.scene, frames or 120), fps or 30.0)
    result = film.film(trained, poses, out, shown=shown or ("rgb",), fps=rate)
    return console.report(result, as_json=as_json, text=f"{result['frames']} frames at {rate:g} per second\n{out}")


def mesh(
    run: RunFolder,
    out: Annotated[Path, Option("--out", metavar="FILE", help="File to write: FILE.ply, FILE.glb or FILE.obj; must be new.")],
    resolution: Annotated[int, Option(min=16, max=768, help="Grid points along the longest side of the object's box.")] = 256,
    level: Annotated[
        float, Option(min=0.001, max=0.999, help="Share of light that 1/128 of the box absorbs at the surface.")
    ] = 0.5,
    watertight: Annotated[bool, Option("--watertight", help="Close the surface where it leaves the box.")] = False,
    faces: Annotated[int | None, Option(min=4, help="Target number of triangles.")] = None,
    points: Annotated[int | None, Option(min=1, help="Write this many surface points (PLY) instead of triangles.")] = None,
    stands_on: StandsOn = None,
    follow: Annotated[
        bool, Option("--follow-normals/--density-only", help="Refine the surface to follow the predicted normals.")
    ] = True,
    as_json: console.Json = False,
) -> None:
    """Extract the object's surface as a coloured mesh or point cloud in world coordinates."""
    from koala3d.datasets.core.files import refuse_existing, required_suffix
    from koala3d.reconstruct.output.mesh import extraction, files
    from koala3d.reconstruct.output.shape import stated, uncertainty

    required_suffix(out, *(("meshes", files.SUFFIXES) if points is None else ("points", (".ply",))))
    refuse_existing(out)
    trained = opened(run)
    surface = extraction.extract(
        trained, resolution=resolution, level=level, watertight=watertight, faces=faces, stands_on=stands_on, follow=follow
    )
    certain = uncertainty.of(trained, surface)
    if out.suffix.lower() == ".ply":
        stated.attach(surface, certain)
    uncertainty.store(run, trained.step, certain)
    files.save(surface if points is None else files.points_on(surface, points), out)
    result, text = extraction.summary(surface, trained.scene)
    result, text = result | {"certainty": certain.summary()}, f"{text}\n{uncertainty.text(certain)}"
    console.report({"out": str(out), **result}, as_json=as_json, text=f"{text}\n{out}")


def report(
    run: RunFolder,
    out: NewFolder,
    calibration: Annotated[
        Path | None, Option(metavar="FILE.json", help="Calibration whose accuracy the report includes.")
    ] = None,
    as_json: console.Json = False,
) -> None:
    """Write an HTML report of a run: metrics, rendered and true images, error over time."""
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.reconstruct.output.report import write

    refuse_existing(out)
    result = write(opened(run), out, calibration=calibration)
    console.report(result, as_json=as_json, text=result["report"])


def opened(run: Path) -> "TrainedModel":
    """A run's trained model; compiled programs are cached on disk."""
    from koala3d.reconstruct.backend import configure_process
    from koala3d.reconstruct.output.trained_model import TrainedModel

    configure_process()
    return TrainedModel.open(run)
