"""The command `run`: records the views of a trajectory, or views that the session chooses by what they add."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from koala3d.capture.cli.confirm import asker
from koala3d.capture.cli.options import (
    SAFETY,
    CalibrationFile,
    Confirm,
    Ignore,
    RigName,
    Scene,
    Seed,
    Settings,
    Slow,
    TakeOver,
    TimeScale,
    TrajectoryName,
)
from koala3d.datasets.core import console
from koala3d.datasets.core.options import Rerun

if TYPE_CHECKING:
    from koala3d.capture.drivers.protocols import Robot
    from koala3d.capture.model.carrier import Carrier
    from koala3d.capture.model.trajectory import Trajectory
    from koala3d.capture.planning import PlannedView
    from koala3d.capture.sessions.adaptive.loop import CoverageGoal
    from koala3d.capture.sessions.start import SessionOptions

CHOOSING = "Views that the session chooses"
Adaptive = Annotated[
    bool,
    Option(
        "--adaptive",
        help="Choose the views by what they add; the trajectory says where the camera may be.",
        rich_help_panel=CHOOSING,
    ),
]
UntilCoverage = Annotated[
    float | None,
    Option(
        "--until-coverage",
        min=0.0,
        max=1.0,
        help="End when three views at 60 degrees or less have seen this share of the surface within reach.",
        rich_help_panel=CHOOSING,
    ),
]
Views = Annotated[int | None, Option("--views", min=1, max=999, help="End after this number of views.", rich_help_panel=CHOOSING)]
Minutes = Annotated[
    float | None, Option("--minutes", min=0.0, help="End after this time of this command.", rich_help_panel=CHOOSING)
]


Out = Annotated[Path | None, Option(metavar="RECORDING", help="New folder to write, or with --resume an existing one.")]
Radiometry = Annotated[
    Path | None,
    Option(metavar="FLAT.npz", help="File of 'capture flat' to keep with the recording. Default: that of the rig file."),
]
Pose = Annotated[
    str,
    Option("--pose", metavar="NAME", help="How the object lies: after a person has turned it over, 'under' or another name."),
]
DryRun = Annotated[
    bool,
    Option(
        "--dry-run",
        help="Drive the arm to every view without the camera, at a quarter of the speed or with --slow, and record nothing.",
        rich_help_panel=SAFETY,
    ),
]


def run(
    trajectory: TrajectoryName,
    out: Out = None,
    rig: RigName = "sim",
    adaptive: Adaptive = False,
    until_coverage: UntilCoverage = None,
    views: Views = None,
    minutes: Minutes = None,
    calibration: CalibrationFile = None,
    scene: Scene = "",
    seed: Seed = 0,
    time_scale: TimeScale = 20.0,
    radiometry: Radiometry = None,
    pose: Pose = "upright",
    slow: Slow = 1.0,
    confirm: Confirm = False,
    dry_run: DryRun = False,
    resume: Annotated[bool, Option("--resume", help="Continue an interrupted recording.")] = False,
    take_over: TakeOver = False,
    ignore: Ignore = None,
    view: Annotated[bool, Option("--view", help="Show the session in the browser, with a stop button.")] = False,
    port: console.Port = 8080,
    rerun: Rerun = None,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Record every view of a trajectory. Ctrl-C stops the arm and keeps the frames; --resume continues.

    With --adaptive the session first looks around. Then it takes the view that adds most each time: surface that few views have
    seen, and new angles on places whose colour changes. Travel counts against a view.
    """
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.rig.naming import scene_for
    from koala3d.capture.sessions.adaptive.loop import CoverageGoal
    from koala3d.capture.sessions.start import SessionOptions
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.datasets.reports import rerun_file
    from koala3d.datasets.scene import checked_name

    goal = CoverageGoal(until_coverage, views, minutes)
    _agree(adaptive, goal, calibration, view)
    _require_out(out, dry_run, {"--adaptive": adaptive, "--view": view, "--resume": resume, "--rerun": rerun is not None})
    rerun_file.require(rerun)
    session = load_trajectory(trajectory, overrides=settings)
    options = SessionOptions(rig, scene_for(rig, scene, session), seed, time_scale, radiometry, take_over, resume, slow=slow)
    options = replace(options, ask=asker(confirm), ignore=tuple(ignore or ()), pose=checked_name(pose, where="--pose"))
    if out is None:
        found, text = _driven(session, options)
        console.report(found, as_json=as_json, text=text)
        return
    if not resume:
        refuse_existing(out)
    try:
        with _shown_in_rerun(rerun, out, rig):
            chosen = adaptive and _chosen(session, out, goal, options, calibration)
            found, text = chosen or _every(session, out, options, port if view else None)
    except KeyboardInterrupt:
        raise _stopped(out, "by Ctrl-C or from the page" if view else "by Ctrl-C") from None
    console.report(found, as_json=as_json, text=text)


def _stopped(out: Path, how: str) -> Exception:
    """What a person is told who stopped a recording."""
    from koala3d.datasets.core.errors import KoalaError

    remedy = f"the same command with --resume continues in {out}" if out.exists() else "nothing was written"
    return KoalaError(f"stopped {how}, the arm stands still", where=out, remedy=remedy)


def _require_out(out: Path | None, dry_run: bool, others: dict[str, bool]) -> None:
    """Raise UsageError unless either a recording or a dry run is wanted."""
    from koala3d.datasets.core.errors import UsageError

    if out is None and not dry_run:
        raise UsageError("no recording is named", where="--out", remedy="name a new folder, or add --dry-run")
    if dry_run and (given := [name for name, value in {"--out": out is not None, **others}.items() if value]):
        raise UsageError("means nothing to a dry run, which records nothing", where=given[0], remedy="leave it out")


def _driven(session: "Trajectory", options: "SessionOptions") -> tuple[dict[str, Any], str]:
    """Drive the arm without the camera; what to report."""
    from koala3d.capture.sessions.dry_run import SLOW, drive

    start, number = time.monotonic(), session.number
    options = options if options.slow < 1.0 else replace(options, slow=SLOW)
    with _progress("dry run", number, options) as shown:
        drive(session, options, lambda name: shown.advance())
    seconds = time.monotonic() - start
    return {
        "views": number,
        "seconds": round(seconds, 2),
    }, f"{session.name}: {number} views in {seconds:.0f} s, nothing is recorded"


def _progress(what: str, number: int, options: "SessionOptions") -> "AbstractContextManager[console.Progress]":
    """The progress of a session; plain lines if questions are asked between them."""
    return (
        console.progress(what, number, "views") if options.ask is None else nullcontext(console.Progress(what, number, "views"))
    )


def _agree(adaptive: bool, goal: "CoverageGoal", calibration: Path | None, view: bool) -> None:
    """Raise UsageError where options contradict each other."""
    from koala3d.datasets.core.errors import UsageError

    given = {"--until-coverage": goal.until_coverage, "--views": goal.views, "--minutes": goal.minutes}
    needless = [name for name, value in {**given, "--calibration": calibration}.items() if value is not None]
    if needless and not adaptive:
        raise UsageError("is for sessions that choose their views", where=needless[0], remedy="add --adaptive, or leave it out")
    if view and adaptive:
        remedy = "leave it out; 'capture view RECORDING' shows the recording afterwards, with why each view was taken"
        raise UsageError("shows a plan, and a session that chooses its views has none", where="--view", remedy=remedy)


def _chosen(
    session: "Trajectory", out: Path, goal: "CoverageGoal", options: "SessionOptions", calibration: Path | None
) -> tuple[dict[str, Any], str]:
    """Record views that the session chooses; what to report."""
    from koala3d.capture.sessions.adaptive import session as choosing
    from koala3d.datasets.calibration import Calibration
    from koala3d.datasets.recording import Recording

    start = time.monotonic()
    known = None if calibration is None else Calibration.load(calibration)
    if known is None:
        console.hint("no --calibration: the object's box stands for its shape, and colours are not compared")
    outcome = choosing.run(session, out, goal, options, known, choosing.show)
    frames, seconds = len(Recording.open(out).frames), time.monotonic() - start
    return choosing.facts(out, outcome, frames, seconds), choosing.describe(out, outcome, frames, seconds)


def _every(session: "Trajectory", out: Path, options: "SessionOptions", port: int | None) -> tuple[dict[str, Any], str]:
    """Record every view of a trajectory, with a page at a port where one is given; what to report."""
    from koala3d.capture.planning import plan
    from koala3d.capture.recording.recorder import record
    from koala3d.capture.rig.naming import describe
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.recording import MANIFEST, Recording, chosen_views

    if options.resume and (out / MANIFEST).is_file() and chosen_views(Recording.open(out)):
        raise UsageError("chose its own views", where=out, remedy="continue it with --adaptive")
    description, start = describe(options.rig), time.monotonic()
    mount, cameras, robots = description.carrier(), [name for name in description.each if name], list["Robot"]()
    nominal = plan(session, mount)
    with ExitStack() as stack:
        if port is not None:
            stack.enter_context(_watched(out / description.name, session, mount, nominal, robots, port))
        shown = stack.enter_context(_progress("capture", len(nominal), options))
        with options.opened(session, out) as opened:
            robots.append(opened.robot)

            def advance(name: str) -> None:
                shown.advance()
                shown.note(f"view {name}")

            planned = plan(session, opened.carrier, nominal=nominal)
            taken = len(record(session, opened, out, resume=options.resume, planned=planned, advance=advance).frames)
    seconds = time.monotonic() - start
    found = {"recording": str(out), "frames": taken, "seconds": round(seconds, 2), "scene": options.scene or None}
    by = f" by each of {', '.join(cameras)}" if cameras else ""
    return {**found, "cameras": cameras}, f"{out}: {taken} views{by} in {seconds:.0f} s"


@contextmanager
def _shown_in_rerun(rerun: Path | None, out: Path, rig: str) -> Iterator[None]:
    """At the end, or after an error or Ctrl-C, write what was recorded (by the first of several cameras) for Rerun's viewer."""
    from koala3d.capture.rig.naming import describe
    from koala3d.datasets.recording import MANIFEST

    try:
        yield
    finally:
        path = out / describe(rig).name
        if rerun is not None and (path / MANIFEST).is_file():
            from koala3d.capture.page import rerun_session

            rerun_session.write(path, rerun)


@contextmanager
def _watched(
    out: Path, session: "Trajectory", mount: "Carrier", planned: "list[PlannedView]", robots: "list[Robot]", port: int
) -> Iterator[None]:
    """A page that shows a recording while it is made. Its button stops the `robots` and ends the session as Ctrl-C does."""
    from koala3d.capture.page.view import watch
    from koala3d.datasets.page import open_page

    session_thread = threading.get_ident()

    def stop() -> None:
        signal.pthread_kill(session_thread, signal.SIGINT)  # to the thread itself, so that it wakes
        for robot in robots:
            robot.stop()  # the session may be busy with the camera

    with open_page(session.name, port) as page:
        watch(page, out, session, mount, planned, stop=lambda: page.in_background(stop))
        console.hint(f"{page.url} shows the session")
        yield
