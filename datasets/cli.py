"""The `datasets` command: build, inspect, check and export scenes."""

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from koala3d.datasets.core import console, options
from koala3d.datasets.core.help import CHECK, LOOK, MAIN
from koala3d.datasets.core.options import DataRoot, Json, OutFolder, OutPage, Port
from koala3d.datasets.edit import commands as edit
from koala3d.datasets.process import commands as process
from koala3d.datasets.segmentation import commands as segmentation

app = console.make_app("datasets", "Build scenes from recordings; inspect, check, edit and export scenes of every format.")

Images = Annotated[
    str | None, typer.Option(metavar="NAME", help="Image folder to read, where there are several sizes, such as images_4.")
]
Sizes = Annotated[str, typer.Option(metavar="N,N,...", help="Also write images_N at 1/N of the size, such as 2,4,8.")]

Quick = Annotated[bool, typer.Option("--quick", help="Do not match features between views.")]


def _formats(incomplete: str) -> list[str]:
    """Completion of format names in the shell."""
    from koala3d.datasets.formats import WRITERS

    return [name for name in WRITERS if name.startswith(incomplete)]


@app.command(panel=MAIN)
def build(
    recording: Annotated[Path, typer.Argument(help="Folder written by 'capture run', or a ROS bag.")],
    calibration: Annotated[Path, typer.Option(help="File written by 'calib handeye'.")],
    out: OutFolder,
    sizes: Sizes = "",
    radiometry: Annotated[
        Path | None, typer.Option(metavar="FLAT.npz", help="File of 'capture flat', in place of the recording's own.")
    ] = None,
    white: Annotated[
        float | None,
        typer.Option(
            min=0.01,
            max=1e4,
            help="Light that becomes white in a picture of several exposures; 1 is white in the longest. Default: measured.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Make a posed scene from a recording and a calibration.

    If each view was taken under several sets of lamps, the folder holds a scene for each set.
    """
    from koala3d.datasets.bags.command import opened
    from koala3d.datasets.building.build import build_under_lamps
    from koala3d.datasets.checks.check import summary
    from koala3d.datasets.recording import Recording

    recording = opened(recording)
    with console.progress("building", len(Recording.open(recording).frames), "frames") as shown:
        options: dict[str, Any] = {"sizes": _numbers(sizes), "radiometry": radiometry, "white": white}
        scenes = build_under_lamps(recording, calibration, out, **options, done=shown.advance)
    found = {str(out / name) if name else str(out): summary(scene) for name, scene in scenes.items()}
    text = "\n".join(f"{_text(facts)}\nwritten to {path}" for path, facts in found.items())
    (first, *others) = [{"scene": path, **facts} for path, facts in found.items()]
    console.report({**first, **({"scenes": [first, *others]} if others else {})}, as_json=as_json, text=text)


@app.command(panel=LOOK)
def info(
    scene: options.Scene,
    images: Images = None,
    measure: Annotated[bool, typer.Option("--measure", help="Where no bounds are stated, measure them in the images.")] = False,
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Show what a scene contains: views, camera, bounds, truth."""
    from koala3d.datasets.checks.check import summary
    from koala3d.datasets.formats import load_scene

    found = summary(load_scene(scene, data_root=data_root, images=images, measure=measure))
    console.report(found, as_json=as_json, text=_text(found))


@app.command(panel=CHECK)
def check(
    scene: options.Scene, images: Images = None, quick: Quick = False, data_root: DataRoot = None, as_json: Json = False
) -> int:
    """Read every file of a scene and list what is wrong.

    Each finding is one line: what, where, why and how to fix it. The exit code is 1 if there is an error."""
    from koala3d.datasets.checks.check import check as check_scene
    from koala3d.datasets.core.findings import tally

    with console.progress("checking", 1, "views") as shown:
        findings = check_scene(scene, data_root=data_root, images=images, matches=not quick, done=shown.show)
    errors, warnings = tally(findings)
    verdict = f"{errors} errors, {warnings} warnings" if findings else "nothing is wrong"
    text = "\n".join([*(finding.line for finding in findings), verdict])
    console.report({"errors": errors, "findings": [vars(finding) for finding in findings]}, as_json=as_json, text=text)
    return 1 if errors else 0


@app.command(panel=LOOK)
def view(
    scene: options.Scene,
    port: Port = 8080,
    images: Images = None,
    quick: Quick = False,
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Show a scene in the browser: cameras, points, bounds, images and the findings of 'datasets check'."""
    from koala3d.datasets.core.errors import KoalaError
    from koala3d.datasets.formats import load_scene
    from koala3d.datasets.page import open_page
    from koala3d.datasets.reports.page.view import describe, show

    problems: list[KoalaError] = []
    loaded = load_scene(scene, data_root=data_root, images=images, problems=problems)
    with open_page(loaded.name, port) as page:
        show(page, scene, loaded, quick=quick, data_root=data_root, images=images)
        text = f"{page.url} shows {loaded.name}, {len(loaded.views)} views; Ctrl-C ends it"
        console.report({"url": page.url, **describe(loaded)}, as_json=as_json, text=text)
        page.serve()


@app.command(panel=LOOK)
def report(
    scene: options.Scene,
    out: OutPage,
    images: Images = None,
    quick: Quick = False,
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Write an HTML report on a scene: figures, the findings of 'datasets check', cameras, every view."""
    from koala3d.datasets.core.findings import tally
    from koala3d.datasets.reports.scene import write

    with console.progress("checking", 1, "views") as shown:
        findings = write(
            scene, out, matches=not quick, made_by=console.command_line(), done=shown.show, data_root=data_root, images=images
        )
    errors, warnings = tally(findings)
    text = f"{errors} errors, {warnings} warnings\n{out}"
    console.report({"out": str(out), "errors": errors, "warnings": warnings}, as_json=as_json, text=text)


@app.command(panel=MAIN)
def export(
    scene: options.Scene,
    format: Annotated[
        str,
        typer.Option(help="koala, blender, nerfstudio, llff, dtu, colmap, colmap-text or mipnerf360.", autocompletion=_formats),
    ],
    out: OutFolder,
    source: Annotated[str | None, typer.Option("--from", help="Format of SCENE, where it has several.")] = None,
    images: Images = None,
    sizes: Sizes = "",
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Write a scene in another format. Images are undistorted where that format has no lens model."""
    from koala3d.datasets.building.build import extra_truth
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.datasets.formats import find, load_scene, save_scene

    refuse_existing(out)
    loaded = load_scene(scene, data_root=data_root, format=source, images=images)
    with console.progress("exporting", len(loaded.views), "views") as shown:
        extra = extra_truth(find(scene, data_root))
        limits = save_scene(loaded, out, format, sizes=_numbers(sizes), extra=extra, done=shown.advance)
    count = len(loaded.views)
    text = f"{count} views written to {out}" + (f"\n{limits}" if limits else "")
    console.report({"out": str(out), "format": format, "views": count, "limits": limits}, as_json=as_json, text=text)


@app.command(panel=CHECK)
def truth(
    recording: Annotated[
        Path,
        typer.Argument(help="Folder written by 'capture run' on the simulated rig, or by 'merge --turned' of two such."),
    ],
    calibration: Annotated[Path | None, typer.Option(help="File written by 'calib handeye', of a recording.")] = None,
    as_json: Json = False,
) -> None:
    """Compare a calibration with the true geometry of a simulated rig, or the motion in a merged scene with the true one."""
    if calibration is None:
        _turned_truth(recording, as_json)
        return
    from koala3d.datasets.calibration import Calibration
    from koala3d.datasets.checks.truth import calibration_error

    found = calibration_error(recording, Calibration.load(calibration))
    text = "error of the hand-eye pose: {hand_eye_mm:.3f} mm, {hand_eye_deg:.4f} deg\n".format(**found)
    if "board_mm" in found:
        text += "error of the target on the flange: {board_mm:.3f} mm, {board_deg:.4f} deg".format(**found)
    else:
        numbers = "{camera_mm:.3f} mm, {camera_deg:.4f} deg (median of {frames}, arm errors included)".format(**found)
        text += f"error of the camera poses: {numbers}"
    console.report(found, as_json=as_json, text=text)


def _turned_truth(scene: Path, as_json: bool) -> None:
    from koala3d.datasets.checks.truth import turned_error
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.formats import load_scene
    from koala3d.datasets.recording import MANIFEST

    if (scene / MANIFEST).is_file():
        raise UsageError("nothing says what is to be compared", where=scene, remedy="add --calibration calibration.json")
    found = turned_error(load_scene(scene))
    text = (
        "error of the motion: {shift_mm:.3f} mm, {turn_deg:.4f} deg; stated: {shift_deviation_mm:.3f} mm, "
        "{turn_deviation_deg:.4f} deg; {in_deviations:.2f} standard deviations"
    )
    console.report(found, as_json=as_json, text=text.format(**found))


for part in (process, edit, segmentation):
    part.add_to(app)


def _numbers(text: str) -> tuple[int, ...]:
    """The integers of a list such as "2,4,8". Raises UsageError for anything else."""
    from koala3d.datasets.core.errors import UsageError

    try:
        return tuple(int(word) for word in text.split(",") if word.strip())
    except ValueError:
        raise UsageError("is not a list of integers", where=repr(text), remedy="write it as 2,4,8") from None


def _text(found: dict[str, Any]) -> str:
    """`summary` for a person."""
    views = ", ".join(f"{count} {split}" for split, count in found["views"].items() if count)
    sizes = ", ".join(f"{width}x{height}" for width, height in found["sizes"][:4])
    camera = found["camera"]
    lens = "distorted" if found["distorted"] else "pinhole"
    unit = "m" if found["metric"] else "units"
    low, high = ([round(value, 4) for value in corner] for corner in found["box"])
    nearest, furthest = found["distance_to_focus"]
    far = "infinity" if found["far"] is None else f"{found['far']:.4g} {unit}"
    lines = [
        f"scene        {found['name']} ({found['format']})",
        f"views        {views}; {sizes} px, {found['channels']} channels{', masks' if found['masks'] else ''}",
        f"camera       {lens}, fx {camera['fx']:.2f} fy {camera['fy']:.2f} cx {camera['cx']:.2f} cy {camera['cy']:.2f}"
        + (f" (first of {found['cameras']})" if found["cameras"] > 1 else ""),
        f"object box   {low} to {high} {unit}",
        f"cameras      {nearest:.3g} to {furthest:.3g} {unit} from where they look",
        f"near, far    {found['near']:.4g} {unit}, {far}",
        f"bounds from  {found['bounds_from']}",
        f"background   {found['background']}",
        f"truth        {', '.join(f'{key} ({count})' for key, count in found['truth'].items()) or 'none'}",
    ]
    return os.linesep.join([*lines, *(f"note         {note}" for note in found["notes"])])


def main() -> None:
    """Entry point of the `datasets` command."""
    console.run(app)


if __name__ == "__main__":
    main()
