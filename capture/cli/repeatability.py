"""The command `repeatability`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from koala3d.capture.cli.confirm import asker
from koala3d.capture.cli.options import (
    CalibrationFile,
    Confirm,
    Ignore,
    Resume,
    RigName,
    Seed,
    SessionFolder,
    Settings,
    Slow,
    TakeOver,
    TimeScale,
)
from koala3d.datasets.core import console

FEWEST_VIEWS = 5
"""From fewer views the camera cannot be estimated."""
Room = Annotated[Path, Argument(metavar="[TRAJECTORY]", help="Trajectory with the target and the settings; its views are used.")]


def repeatability(
    out: SessionFolder,
    trajectory: Room = Path("calibration"),
    rig: RigName = "sim",
    visits: Annotated[int, Option("--visits", min=3, max=9999, help="How often each view is taken.")] = 30,
    views: Annotated[int, Option("--views", min=2, max=50, help="Number of views, evenly spread over the trajectory's.")] = 6,
    calibration: CalibrationFile = None,
    seed: Seed = 0,
    time_scale: TimeScale = 20.0,
    resume: Resume = False,
    take_over: TakeOver = False,
    ignore: Ignore = None,
    slow: Slow = 1.0,
    confirm: Confirm = False,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Measure by pictures of a target how well the arm comes back, and how it drifts while it warms up.

    The arm goes round after round to the same views. The spread of the pose in which the pictures show the target is that of arm,
    bracket and camera together, at the target. Without a calibration, the camera is estimated from the same pictures.
    """
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.sessions.repeatability import session
    from koala3d.capture.sessions.start import SessionOptions
    from koala3d.datasets.core.errors import KoalaError, UsageError
    from koala3d.datasets.core.files import refuse_existing

    room = load_trajectory(trajectory, overrides=settings)
    if room.target is None:
        raise UsageError("has no calibration target", where=trajectory, remedy="use 'calibration', or state 'target'")
    if calibration is None and views < FEWEST_VIEWS:
        remedy = f"take {FEWEST_VIEWS} or more, or add --calibration CALIBRATION.json"
        raise UsageError("are too few views to estimate the camera from", where=f"--views {views}", remedy=remedy)
    if not resume:
        refuse_existing(out)
    options = SessionOptions(rig, "", seed, time_scale, take_over=take_over, resume=resume, slow=slow)
    options = replace(options, ask=asker(confirm), ignore=tuple(ignore or ()))
    try:
        found = session.run(room, out, options, visits, views, calibration)
    except KeyboardInterrupt:
        remedy = f"the same command with --resume continues in {out}" if out.exists() else "nothing was written"
        raise KoalaError("stopped by Ctrl-C, the arm stands still", where=out, remedy=remedy) from None
    console.report(session.facts(out, found), as_json=as_json, text=session.describe(out, found))
