"""The command that shows the live picture and what it says."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from capture.options import RigName, Settings, TrajectoryName
from datasets.core import console


def look(
    trajectory: TrajectoryName = Path("koala_demo"),
    rig: RigName = "sim",
    once: Annotated[bool, Option("--once", help="Print the figures of one picture and a burst, without the page.")] = False,
    region: Annotated[
        str | None, Option(metavar="X,Y,W,H", help="Region for focus, exposure and balance [px]. Default: half, in the middle.")
    ] = None,
    burst: Annotated[int, Option(min=8, max=1000, help="Pictures of the burst that shows flicker.")] = 40,
    balance: Annotated[
        Path | None, Option(metavar="FLAT.npz", help="New file for the white balance of a grey card in the region.")
    ] = None,
    picture: Annotated[Path | None, Option(metavar="LOOK.png", help="With --once: also write the marked picture.")] = None,
    scene: Annotated[str, Option(help="Simulation only: a scene of 'capture list'. Default: one that fits.")] = "",
    port: console.Port = 8080,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Show the live picture in the browser: focus, clipping, histogram, flicker of lamps, white balance, exposure.

    The camera takes the settings of the trajectory. The arm is not used."""
    from capture.look.analysis import Part
    from capture.rig.opening import describe, is_simulated, open_camera, scene_for
    from capture.trajectory import load_trajectory
    from datasets.core.files import refuse_existing

    for path in (balance, picture):
        if path is not None:
            refuse_existing(path)
    session, description = load_trajectory(trajectory, overrides=settings), describe(rig)
    scene = scene_for(rig, scene, session) if is_simulated(rig, description) else ""
    width, height = session.camera.width, session.camera.height
    part = Part.middle(width, height) if region is None else Part.parse(region, width, height)
    stored = description.camera.radiometry
    with ExitStack() as stack:
        camera = stack.enter_context(open_camera(rig, session, scene=scene))
        if once:
            found, lines = _once(camera, part, burst, balance, picture, stored)
            console.report(found, as_json=as_json, text="\n".join(lines))
            return
        from capture.page.look import LookPage
        from datasets.page import open_page

        page = stack.enter_context(open_page(f"{session.name}, live", port))
        live = LookPage(page, camera, part, burst=burst, balance=balance, stored=stored)
        console.report({"url": page.url}, as_json=as_json, text=f"{page.url} shows the live picture; Ctrl-C ends it")
        page.wait()
        live.end()


def _once(
    camera: Any, part: Any, burst: int, balance: Path | None, picture: Path | None, stored: str
) -> tuple[dict[str, Any], list[str]]:
    """The figures for a program, and for a person."""
    from capture.look import flicker
    from capture.look.analysis import Look
    from capture.look.balance import stored_response, white_balance, words

    image = camera.grab()
    seen = Look.at(image, part)
    with console.progress("burst", burst, "pictures") as shown:
        found = flicker.flicker(*flicker.burst(camera, part, burst, shown.advance, stored_response(camera, stored)))
    content: dict[str, Any] = {"region": vars(part), "look": vars(seen)}
    content["flicker"] = {**vars(found), "seen": found.is_seen, "of_lamps": found.of_lamps, "quiet_us": found.quiet_us}
    lines = [*seen.lines, found.line]
    if balance is not None:
        response = white_balance(camera, part, stored)
        response.save(balance)
        content["balance"] = response.balance
        lines += [words(response), f"written to {balance}"]
    if picture is not None:
        import numpy as np

        from capture.page.live import with_histogram
        from capture.page.overlay import shown as marked
        from datasets.imaging import images

        plain, drawn = marked(image.pixels, part, peaking=False, zebra=False), marked(image.pixels, part)
        images.write(picture, np.concatenate([drawn, with_histogram(plain)[0][len(plain) :]]))
        lines.append(f"picture in {picture}")
    return content, lines
