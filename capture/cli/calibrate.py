"""The command `calibrate`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from koala3d.capture.cli.confirm import asker
from koala3d.capture.cli.options import (
    Confirm,
    Ignore,
    Resume,
    RigName,
    Scene,
    Seed,
    SessionFolder,
    Settings,
    Slow,
    TakeOver,
    TimeScale,
)
from koala3d.datasets.core import console

GOAL, ARM = "When it ends", "Arm and lens"
Room = Annotated[
    Path, Argument(metavar="[TRAJECTORY]", help="Trajectory with the target, the settings, and views where the camera may be.")
]
Lens = Annotated[str, Option("--lens", help="Lens model: auto, brown, rational, fisheye or splined.", rich_help_panel=ARM)]


def calibrate(
    out: SessionFolder,
    trajectory: Room = Path("calibration"),
    rig: RigName = "sim",
    until_mm: Annotated[
        float, Option("--until-mm", min=1e-4, help="Wanted error of the camera's place on the flange [mm].", rich_help_panel=GOAL)
    ] = 0.05,
    until_deg: Annotated[
        float, Option("--until-deg", min=1e-5, help="Wanted error of its orientation [deg].", rich_help_panel=GOAL)
    ] = 0.01,
    max_views: Annotated[int, Option("--max-views", min=5, max=999, help="Largest number of views.", rich_help_panel=GOAL)] = 80,
    arm_mm: Annotated[
        float,
        Option("--arm-mm", min=1e-6, help="Error of the flange's place, standard deviation per axis [mm].", rich_help_panel=ARM),
    ] = 0.05,
    arm_deg: Annotated[
        float,
        Option("--arm-deg", min=1e-6, help="Error of its orientation, standard deviation per axis [deg].", rich_help_panel=ARM),
    ] = 0.01,
    lens: Lens = "auto",
    scene: Scene = "",
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
    """Calibrate camera and mount with views that the session chooses itself.

    After each view camera and mount are estimated, and the reachable view that improves them most is next. The session ends when
    both errors are below the wanted ones with 95 % certainty, or when no view helps. Ctrl-C stops the arm and keeps the views;
    --resume continues.
    """
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.sessions.calibrate import session
    from koala3d.capture.sessions.calibrate.loop import AccuracyGoal
    from koala3d.capture.sessions.start import SessionOptions
    from koala3d.datasets.core.errors import KoalaError, UsageError
    from koala3d.datasets.core.files import refuse_existing

    room = load_trajectory(trajectory, overrides=settings)
    if room.target is None:
        raise UsageError("has no calibration target", where=trajectory, remedy="use 'calibration', or state 'target'")
    if not resume:
        refuse_existing(out)
    goal = AccuracyGoal((until_mm, until_deg), max_views)
    arm = ["--arm-mm", str(arm_mm), "--arm-deg", str(arm_deg), "--lens", lens]
    options = SessionOptions(rig, scene, seed, time_scale, take_over=take_over, resume=resume, slow=slow)
    options = replace(options, ask=asker(confirm), ignore=tuple(ignore or ()))
    try:
        outcome = session.run(room, out, goal, options, arm, show=lambda views, answer: session.show(views, answer, goal.until))
    except KeyboardInterrupt:
        remedy = f"the same command with --resume continues in {out}" if out.exists() else "nothing was written"
        raise KoalaError("stopped by Ctrl-C, the arm stands still", where=out, remedy=remedy) from None
    console.report(session.facts(out, outcome, goal), as_json=as_json, text=session.describe(out, outcome, goal))
