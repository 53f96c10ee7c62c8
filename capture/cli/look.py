"""The command `look`: shows the live picture and what it says."""

from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from koala3d.capture.cli.options import Ignore, RigName, Scene, Settings, Slow, TakeOver, TrajectoryName
from koala3d.datasets.core import console

ONCE, ARM = "Without the page", "With the arm"
BURST = 40
"""Pictures of the burst that shows flicker."""
TIME_SCALE = 20.0
"""Speed of a simulated arm, as in 'capture run'."""


Once = Annotated[
    bool, Option("--once", help="Print the figures of one picture and a burst, without the page.", rich_help_panel=ONCE)
]
Picture = Annotated[
    Path | None,
    Option(metavar="LOOK.png", help="With --once: also write the marked picture.", rich_help_panel=ONCE),
]
Balance = Annotated[
    Path | None,
    Option(metavar="FLAT.npz", help="New file for the white balance of a grey card in the middle of the picture."),
]
WithArm = Annotated[
    bool, Option("--arm", help="Connect the arm too; the page moves it to views of the trajectory.", rich_help_panel=ARM)
]
Go = Annotated[str | None, Option("--go", metavar="VIEW", help="First move the arm to this view.", rich_help_panel=ARM)]
Teach = Annotated[
    Path | None,
    Option(
        "--teach",
        metavar="TRAJECTORY.yaml",
        help="With --arm: a button appends the arm's pose to this file as a view. A new file takes the trajectory's settings.",
        rich_help_panel=ARM,
    ),
]
Box = Annotated[
    Path | None,
    Option(
        metavar="CALIBRATION.json",
        help="Draw the object's box as this calibration sees it from where the arm is.",
        rich_help_panel=ARM,
    ),
]


def look(
    trajectory: TrajectoryName = Path("koala_demo"),
    rig: RigName = "sim",
    once: Once = False,
    picture: Picture = None,
    balance: Balance = None,
    scene: Scene = "",
    arm: WithArm = False,
    go: Go = None,
    teach: Teach = None,
    calibration: Box = None,
    take_over: TakeOver = False,
    ignore: Ignore = None,
    slow: Slow = 1.0,
    port: console.Port = 8080,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Show the live picture in the browser: focus, clipping, histogram, flicker of lamps, white balance, exposure.

    The camera takes the settings of the trajectory. The arm is left alone, except with --arm or --go.
    """
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.rig.naming import describe, is_simulated, scene_for
    from koala3d.capture.sessions.live.analysis import Part
    from koala3d.datasets.core.files import refuse_existing

    for path in (balance, picture):
        if path is not None:
            refuse_existing(path)
    session, description = load_trajectory(trajectory, overrides=settings), describe(rig)
    scene = scene_for(rig, scene, session) if is_simulated(rig, description) else ""
    width, height = session.camera.width, session.camera.height
    part = Part.middle(width, height)
    stored = description.camera.radiometry
    with ExitStack() as stack:
        opening = _opened(rig, session, scene, arm or go is not None, take_over, ignore or (), slow)
        camera, jog = stack.enter_context(opening)
        outline, teaching = _outline(calibration, session, camera, jog), _teaching(teach, session, jog)
        if jog is not None and go is not None:
            jog.go(go)
        if once:
            box = (jog, outline) if jog is not None and outline is not None else None
            found, lines = _once(camera, part, balance, picture, stored, box)
            console.report(found, as_json=as_json, text="\n".join(lines))
            return
        from koala3d.capture.page.look import LookPage
        from koala3d.datasets.page import open_page

        page = stack.enter_context(open_page(f"{session.name}, live", port))
        live = LookPage(
            page, camera, part, burst=BURST, balance=balance, stored=stored, jog=jog, outline=outline, teaching=teaching
        )
        console.report({"url": page.url}, as_json=as_json, text=f"{page.url} shows the live picture; Ctrl-C ends it")
        page.wait()
        live.end()


@contextmanager
def _opened(
    rig: str, session: Any, scene: str, with_arm: bool, take_over: bool, ignore: Collection[str], slow: float
) -> Iterator[tuple[Any, Any]]:
    """The camera of a rig, and what moves its arm, which is None where it is left alone."""
    from koala3d.capture.doctor.examine import examination
    from koala3d.capture.rig.cameras import camera_for
    from koala3d.capture.rig.moves import Moves
    from koala3d.capture.rig.opening import open_rig
    from koala3d.capture.sessions.live.jog import Jog

    if not with_arm:
        with camera_for(rig, session, scene=scene) as camera:
            yield camera, None
        return
    examine = examination(Path.cwd(), session.upwards, session.camera.pixel_format == "rgb8", take_over, ignore=ignore)
    options: dict[str, Any] = {"examine": examine, "take_over": take_over, "time_scale": TIME_SCALE}
    options["moves"] = Moves(slow, say=console.hint)
    with open_rig(rig, session, scene=scene, seed=0, **options) as opened:
        yield opened.camera, Jog(opened.robot, session, opened.carrier, opened.moves)


def _outline(path: Path | None, session: Any, camera: Any, jog: Any) -> Any:
    """The object's box through a calibration; None without one."""
    from koala3d.capture.sessions.live.outline import Outline
    from koala3d.datasets.calibration import Calibration
    from koala3d.datasets.core.errors import UsageError

    if path is None:
        return None
    if jog is None:
        raise UsageError("the object's box is drawn from where the arm is", where="--calibration", remedy="add --arm")
    return Outline.of(session, Calibration.load(path), camera.description())


def _teaching(path: Path | None, session: Any, jog: Any) -> Any:
    """The file that takes the arm's poses; None without one."""
    from koala3d.capture.sessions.live.teach import Teaching
    from koala3d.datasets.core.errors import UsageError

    if path is None:
        return None
    if jog is None:
        raise UsageError("views are taken from where the arm is", where="--teach", remedy="add --arm")
    return Teaching(path, session, jog.obstacles)


def _once(
    camera: Any, part: Any, balance: Path | None, picture: Path | None, stored: str, box: Any
) -> tuple[dict[str, Any], list[str]]:
    """The figures for a program, and for a person."""
    from koala3d.capture.sessions.live import flicker
    from koala3d.capture.sessions.live.analysis import Look
    from koala3d.capture.sessions.live.balance import stored_response, white_balance, words

    image = camera.grab()
    seen = Look.at(image, part)
    with console.progress("burst", BURST, "pictures") as shown:
        found = flicker.flicker(*flicker.burst(camera, part, BURST, shown.advance, stored_response(camera, stored)))
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

        from koala3d.capture.page.live import with_histogram
        from koala3d.capture.page.overlay import shown as marked
        from koala3d.datasets.imaging import images

        plain, drawn = marked(image.pixels, part, peaking=False, zebra=False), marked(image.pixels, part)
        if box is not None:
            jog, outline = box
            state = jog.robot.state()
            drawn = outline.drawn(drawn, state.base_from_flange, state.joints)
        images.write(picture, np.concatenate([drawn, with_histogram(plain)[0][len(plain) :]]))
        lines.append(f"picture in {picture}")
    return content, lines
