"""The `datasets` command: build, inspect, check and export scenes."""

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from datasets.core import console
from datasets.core.console import Json, Port
from datasets.edit import commands
from datasets.edit.commands import Out, Root, SceneName

app = console.make_app("datasets", "Make scenes from recordings; inspect, check and export scenes of every format.")

Images = Annotated[str | None, typer.Option(help="Folder of images to use where there are several sizes: images_4.")]
Sizes = Annotated[str, typer.Option(help="Write images_N too: 2,4,8 for a half, a quarter and an eighth of the size.")]


def _formats(incomplete: str) -> list[str]:
    """For the shell."""
    from datasets.formats import WRITERS

    return [name for name in WRITERS if name.startswith(incomplete)]


@app.command()
def build(
    recording: Annotated[Path, typer.Argument(help="Folder written by 'capture run'.")],
    calibration: Annotated[Path, typer.Option(help="File written by 'calib handeye'.")],
    out: Out,
    sizes: Sizes = "",
    as_json: Json = False,
) -> None:
    """Make a posed scene from a recording and a calibration."""
    from datasets.build import build as build_scene
    from datasets.checks.check import summary
    from datasets.recording import Recording

    with console.progress("building", len(Recording.open(recording).frames), "frames") as shown:
        scene = build_scene(recording, calibration, out, sizes=_numbers(sizes), done=shown.advance)
    console.report({"scene": str(out), **summary(scene)}, as_json=as_json, text=f"{_text(summary(scene))}\nwritten to {out}")


@app.command()
def info(
    scene: SceneName,
    images: Images = None,
    measure: Annotated[bool, typer.Option("--measure", help="Measure bounds in the pictures where nothing states them.")] = False,
    data_root: Root = None,
    as_json: Json = False,
) -> None:
    """Say what a scene holds: views, camera, bounds, truth."""
    from datasets.checks.check import summary
    from datasets.formats import load_scene

    found = summary(load_scene(scene, data_root=data_root, images=images, measure=measure))
    console.report(found, as_json=as_json, text=_text(found))


@app.command()
def check(
    scene: SceneName,
    images: Images = None,
    quick: Annotated[bool, typer.Option("--quick", help="Do not match features between views.")] = False,
    data_root: Root = None,
    as_json: Json = False,
) -> int:
    """Read everything in a scene and list what is wrong.

    Each finding is one line: what, where, why and how to mend it. Exit code 1 where there is an error."""
    from datasets.checks.check import check as check_scene

    with console.progress("checking", 1, "views") as shown:

        def advance(count: int, total: int) -> None:
            shown.total = total
            shown.advance(count - shown.done)

        findings = check_scene(scene, data_root=data_root, images=images, matches=not quick, done=advance)
    errors = sum(finding.level == "error" for finding in findings)
    verdict = f"{errors} errors, {len(findings) - errors} warnings" if findings else "nothing is wrong"
    text = "\n".join([*(finding.line for finding in findings), verdict])
    console.report({"errors": errors, "findings": [vars(finding) for finding in findings]}, as_json=as_json, text=text)
    return 1 if errors else 0


@app.command()
def view(
    scene: SceneName,
    port: Port = 8080,
    images: Images = None,
    quick: Annotated[bool, typer.Option("--quick", help="Do not match features between views.")] = False,
    data_root: Root = None,
    as_json: Json = False,
) -> None:
    """Look at a scene in the browser: cameras, points, bounds, pictures and what 'datasets check' finds."""
    from datasets.core.errors import KoalaError
    from datasets.formats import load_scene
    from datasets.page import open_page
    from datasets.page.view import describe, show

    problems: list[KoalaError] = []
    loaded = load_scene(scene, data_root=data_root, images=images, problems=problems)
    with open_page(loaded.name, port) as page:
        show(page, scene, loaded, quick=quick, data_root=data_root, images=images)
        console.report(
            {"url": page.url, **describe(loaded)},
            as_json=as_json,
            text=f"{page.url} shows {loaded.name}, {len(loaded.views)} views; Ctrl-C ends it",
        )
        page.serve()


@app.command()
def report(
    scene: SceneName,
    out: Annotated[Path, typer.Option(metavar="PAGE.html", help="Page to write; must be new.")],
    images: Images = None,
    quick: Annotated[bool, typer.Option("--quick", help="Do not match features between views.")] = False,
    data_root: Root = None,
    as_json: Json = False,
) -> None:
    """Write a page on a scene: what it holds, what 'datasets check' finds, where its cameras are, every view."""
    from datasets.reports.scene import write

    with console.progress("checking", 1, "views") as shown:

        def advance(count: int, total: int) -> None:
            shown.total = total
            shown.advance(count - shown.done)

        findings = write(
            scene, out, matches=not quick, made_by=console.command_line(), done=advance, data_root=data_root, images=images
        )
    errors = sum(finding.level == "error" for finding in findings)
    text = f"{errors} errors, {len(findings) - errors} warnings\n{out}"
    console.report({"out": str(out), "errors": errors, "warnings": len(findings) - errors}, as_json=as_json, text=text)


@app.command()
@app.command("convert")
def export(
    scene: SceneName,
    format: Annotated[
        str,
        typer.Option(help="koala, blender, nerfstudio, llff, dtu, colmap, colmap-text or mipnerf360.", autocompletion=_formats),
    ],
    out: Out,
    source: Annotated[str | None, typer.Option("--from", help="Layout of SCENE, where it has several.")] = None,
    images: Images = None,
    sizes: Sizes = "",
    data_root: Root = None,
    as_json: Json = False,
) -> None:
    """Write a scene in another format, undistorted where that knows no lens."""
    from datasets.build import extra_truth
    from datasets.core.files import refuse_existing
    from datasets.formats import find, load_scene, save_scene

    refuse_existing(out)
    loaded = load_scene(scene, data_root=data_root, format=source, images=images)
    with console.progress("exporting", len(loaded.views), "views") as shown:
        limits = save_scene(
            loaded, out, format, sizes=_numbers(sizes), extra=extra_truth(find(scene, data_root)), done=shown.advance
        )
    count = len(loaded.views)
    text = f"{count} views written to {out}" + (f"\n{limits}" if limits else "")
    console.report({"out": str(out), "format": format, "views": count, "limits": limits}, as_json=as_json, text=text)


@app.command()
def truth(
    recording: Annotated[Path, typer.Argument(help="Folder written by 'capture run' on the simulated rig.")],
    calibration: Annotated[Path, typer.Option(help="File written by 'calib handeye'.")],
    as_json: Json = False,
) -> None:
    """Simulation: say how far a calibration is from the rig as it really is."""
    from datasets.calibration import Calibration
    from datasets.truth import calibration_error

    found = calibration_error(recording, Calibration.load(calibration))
    text = "hand-eye pose off by {hand_eye_mm:.3f} mm and {hand_eye_deg:.4f} deg\n".format(**found)
    text += "cameras off by {camera_mm:.3f} mm and {camera_deg:.4f} deg (median of {frames}, the arm's error included)".format(
        **found
    )
    console.report(found, as_json=as_json, text=text)


@app.command()
def bench(
    count: Annotated[int, typer.Option(help="Pictures to read.")] = 50,
    suffix: Annotated[str, typer.Option(help="Their format: .png, .jpg, .tif or .exr.")] = ".png",
    as_json: Json = False,
) -> None:
    """Time reading 1920x1080 pictures and making them four times smaller."""
    from datasets.imaging.bench import read_and_shrink

    found = read_and_shrink(count, suffix=suffix)
    text = (
        "{images:.0f} images of {width:.0f}x{height:.0f} ({file_mb:.1f} MB each) read and shrunk to "
        "{small_width:.0f}x{small_height:.0f} in {seconds:.2f} s ({cpu_seconds:.2f} s of processor time); "
        "peak memory grew by {peak_growth_mb:.1f} MB after the first ten"
    )
    console.report(found, as_json=as_json, text=text.format(**found))


commands.add_to(app)


def _numbers(text: str) -> tuple[int, ...]:
    """Whole numbers of a list such as "2,4,8". Raises UsageError where it is none."""
    from datasets.core.errors import UsageError

    try:
        return tuple(int(word) for word in text.split(",") if word.strip())
    except ValueError:
        raise UsageError("is no list of whole numbers", where=repr(text), remedy="write it as 2,4,8") from None


def _text(found: dict[str, Any]) -> str:
    """`summary` for a person."""
    views = ", ".join(f"{count} {split}" for split, count in found["views"].items() if count)
    sizes = ", ".join(f"{width}x{height}" for width, height in found["sizes"][:4])
    camera = found["camera"]
    lens = "distorted" if found["distorted"] else "pinhole"
    unit = "m" if found["metric"] else "units"
    low, high = ([round(value, 4) for value in corner] for corner in found["box"])
    nearest, furthest = found["distance_to_focus"]
    lines = [
        f"scene        {found['name']} ({found['format']})",
        f"views        {views}; {sizes} px, {found['channels']} channels{', masks' if found['masks'] else ''}",
        f"camera       {lens}, fx {camera['fx']:.2f} fy {camera['fy']:.2f} cx {camera['cx']:.2f} cy {camera['cy']:.2f}"
        + (f" (first of {found['cameras']})" if found["cameras"] > 1 else ""),
        f"object box   {low} to {high} {unit}",
        f"cameras      {nearest:.3g} to {furthest:.3g} {unit} from where they look",
        f"near, far    {found['near']:.4g}, {'infinity' if found['far'] is None else format(found['far'], '.4g')} {unit}",
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
