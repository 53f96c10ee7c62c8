"""The `calib` command: parses, calls, prints."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from koala3d.calib.export import commands as export_commands
from koala3d.calib.options import (
    READING,
    AllowMm,
    Arm,
    Import,
    Inexact,
    Intrinsics,
    LeaveOut,
    Lens,
    Pictures,
    RigOptions,
    Target,
    allowed_m,
    check_lens,
    spread,
)
from koala3d.calib.targets import commands as target_commands
from koala3d.calib.targets.commands import board_named
from koala3d.calib.together import commands as together_commands
from koala3d.calib.turntable import commands as turntable_commands
from koala3d.datasets.core import console
from koala3d.datasets.core.console import Json
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.help import CHECK, LOOK, MAIN, STUDY
from koala3d.datasets.core.options import Rerun

if TYPE_CHECKING:
    from koala3d.calib.sessions.session import TargetSession
    from koala3d.datasets.calibration import Calibration

app = console.make_app("calib", "Calibrate the camera and its pose on the arm from a recording of a target.")

CalibrationFile = Annotated[
    Path, Argument(metavar="CALIBRATION.json", help="File made by 'calib handeye' or 'calib intrinsics'.")
]
RecordingMoved = Annotated[Path | None, Option("--recording", help="Folder that the calibration was made from, if it was moved.")]
Out = Annotated[Path, Option("--out", help="Calibration file to write (JSON).")]


@app.command("intrinsics", panel=MAIN)
@spread
def intrinsics_command(pictures: Pictures, out: Out, target: Target = None, lens: Lens = "auto", json: Json = False) -> None:
    """Calibrate the camera alone: focal lengths, principal point, distortion."""
    from koala3d.calib.calibrate import calibrate_intrinsics
    from koala3d.calib.page.finish import finish

    _check_out(out)
    check_lens(lens)
    board = None if target is None else board_named(target)
    finish(calibrate_intrinsics(pictures.observe(board)[0], lens), out, json)


@app.command("handeye", panel=MAIN)
@spread
def handeye_command(
    recordings: Annotated[
        list[Path],
        Argument(metavar="RECORDING", help="Folders made by 'capture run', or ROS bags, with one camera and a target in view."),
    ],
    out: Out,
    arm: Arm,
    inexact: Inexact,
    targets: Annotated[
        list[Path] | None,
        Option(
            "--board",
            help="Target to look for instead of the recording's own: a shipped name or a file; repeatable.",
            rich_help_panel=READING,
        ),
    ] = None,
    description: Import = None,
    leave_out: LeaveOut = False,
    intrinsics: Intrinsics = None,
    lens: Lens = "auto",
    allow_mm: AllowMm = 5.0,
    rerun: Rerun = None,
    json: Json = False,
) -> None:
    """Calibrate the whole rig: the camera, its pose on the flange and the pose of the target.

    Everything is estimated together, with its uncertainty, and tested on views held out of the fit. Several recordings show
    several targets, or one that stood in several places; with several --board, each is looked for in every picture.
    """
    from koala3d.calib.calibrate import calibrate_handeye
    from koala3d.calib.page.finish import finish
    from koala3d.calib.targets.told_apart import check_told_apart
    from koala3d.calib.together.boards import calibrate_boards
    from koala3d.datasets.reports import rerun_file

    check_lens(lens)
    rerun_file.require(rerun)
    accuracy, allow_m = arm.accuracy(inexact), allowed_m(allow_mm)
    _check_out(out)
    searched = [(path, board_named(path)) for path in targets or ()]
    check_told_apart([board for _, board in searched], [path for path, _ in searched])
    pairs = [(recording, target) for recording in recordings for target in searched or [(None, None)]]
    if len(pairs) > 1 and intrinsics is not None:
        raise UsageError("several targets determine the camera themselves", where="--intrinsics", remedy="leave it out")
    if len(pairs) > 1 and rerun is not None:
        raise UsageError("shows a session with one target", where="--rerun", why=f"{len(pairs)} given", remedy="leave it out")
    options = {"description": description, "leave_out": leave_out, "intrinsics": intrinsics, "lens": lens}
    read = [RigOptions(recording=recording, **options).read(board) for recording, (_, board) in pairs]
    if len(pairs) == 1:
        calibration = calibrate_handeye(*read[0], accuracy, lens, allow_m)
        finish(calibration, out, json)
        return None if rerun is None else _show_in_rerun(calibration, read[0][0], rerun)
    names = [f"{recording}" if target is None else f"{recording}, {target}" for recording, (target, _) in pairs]
    sessions, where = [session for session, _ in read], [recording for recording, _ in pairs]
    finish(calibrate_boards(sessions, names, where, accuracy=accuracy, lens=lens, allow_m=allow_m).calibration, out, json)


@app.command("compare", panel=STUDY)
@spread
def compare_command(rig: RigOptions, json: Json = False) -> None:
    """Compare all hand-eye methods on one session.

    Prints a table (Markdown) with the error of each method on views held out of its fit.
    """
    from koala3d.calib import comparison

    accuracy = rig.accuracy()
    rows = comparison.compare(*rig.read(), accuracy, rig.lens)
    console.report({"methods": [vars(row) for row in rows]}, as_json=json, text=comparison.markdown(rows))


@app.command("verify", panel=CHECK)
@spread
def verify_command(
    pictures: Pictures,
    calibration: Annotated[Path, Option("--calibration", help="Calibration file made by 'calib handeye'.")],
    json: Json = False,
) -> None:
    """Test how well a calibration predicts a recording.

    Use a recording that the calibration was not made from. Only the pose of the target is fitted.
    """
    from koala3d.calib.handeye.verify import verify
    from koala3d.calib.page.summary import describe_verification
    from koala3d.datasets.calibration import Calibration

    known = Calibration.load(calibration)
    result = verify(pictures.observe(calibration=known)[0], known)
    console.report(result.to_json(), as_json=json, text=describe_verification(result))


@app.command("report", panel=LOOK)
def report_command(
    path: CalibrationFile,
    out: Annotated[Path, Option("--out", help="HTML page to write.")],
    recording: RecordingMoved = None,
    description: Import = None,
    distance: Annotated[
        float, Option("--distance", min=1e-3, max=1e3, help="Show how certain points at this distance are [m].")
    ] = 0.5,
    against: Annotated[
        list[Path] | None, Option("--against", help="Another calibration file, to show how far its camera differs; repeatable.")
    ] = None,
    json: Json = False,
) -> None:
    """Write a page about a calibration.

    It shows residuals, certainty and coverage over the image, errors of each view and error ellipses. The calibration is shown
    as stored. The recording is searched for the target again.
    """
    from koala3d.calib.intrinsics import crossval
    from koala3d.calib.origin import recording_of
    from koala3d.calib.page import report
    from koala3d.calib.page.evidence import gather
    from koala3d.datasets.calibration import Calibration

    _check_out(out)
    calibration = Calibration.load(path)
    others = {path.stem: crossval.compared(calibration.camera, Calibration.load(path).camera, path) for path in against or ()}
    leave_out = calibration.provenance.get("leave_out") is True
    found = Pictures(recording=recording_of(calibration, recording), description=description, leave_out=leave_out)
    session, _ = found.observe(calibration=calibration)
    evidence = gather(calibration, session)
    report.page(evidence, made_by=console.command_line(), distance_m=distance, others=others).write(out)
    differ = {name: {"rms_px": one.rms_px, "most_px": float(one.values_px.max())} for name, one in others.items()}
    lines = [f"{name} differs by {one['rms_px']:.3f} px rms, at most {one['most_px']:.3f} px" for name, one in differ.items()]
    result = {"out": str(out), "residuals": calibration.residuals.to_json(), "difference": differ}
    console.report(result, as_json=json, text="\n".join([*lines, f"written to {out}"]))


@app.command("view", panel=LOOK)
def view_command(
    path: CalibrationFile,
    recording: RecordingMoved = None,
    description: Import = None,
    port: console.Port = 8080,
    json: Json = False,
) -> None:
    """Show a calibration in the browser.

    The page shows the target and the cameras, residuals over the image, coverage and error ellipses.
    """
    from koala3d.calib.page.view import show
    from koala3d.datasets.calibration import Calibration
    from koala3d.datasets.page import open_page

    calibration = Calibration.load(path)
    with open_page(path.stem, port) as page:
        show(page, calibration, recording=recording, description=description)
        rms = calibration.residuals.rms_px
        result = {"url": page.url, "calibration": str(path), "rms_px": rms}
        console.report(result, as_json=json, text=f"{page.url} shows {path}; Ctrl-C ends it")
        page.serve()


@app.command("plan", panel=CHECK)
@spread
def plan_command(
    rig: RigOptions,
    out: Annotated[Path, Option("--out", help="Trajectory file to write (YAML), for 'capture plan' and 'capture run'.")],
    count: Annotated[int, Option("--count", min=1, max=100, help="Number of views.")] = 5,
    grow_mm: Annotated[float, Option("--grow-mm", min=0, help="Margin around the recorded camera positions [mm].")] = 50.0,
    json: Json = False,
) -> None:
    """Plan the most informative next views.

    They lie in the box of the recorded camera positions. Check with 'capture plan' whether the arm can reach them.
    """
    from koala3d.calib import calibrate
    from koala3d.calib.advice import next_views
    from koala3d.datasets.recording import Recording

    accuracy = rig.accuracy()
    _check_out(out)
    session, given = rig.read()
    solution = calibrate.solve(session, given, accuracy, rig.lens)
    found = next_views.plan(solution, count, grow_m=1e-3 * grow_mm)
    manifest = Recording.open(rig.recording).manifest if "recording" in session.provenance else {}
    next_views.write_trajectory(out, found, manifest)
    (before_mm, before_deg), (after_mm, after_deg) = found.before, found.after[-1]
    text = (
        f"standard deviation of the hand-eye pose: {before_mm:.4f} mm, {before_deg:.5f} deg now; "
        f"{after_mm:.4f} mm, {after_deg:.5f} deg expected with {count} more views\nwritten to {out}"
    )
    console.report({"out": str(out), "before": found.before, "after": found.after}, as_json=json, text=text)


@app.command("advise", hidden=True)
@spread
def advise_command(
    recording: Annotated[Path, Argument(metavar="RECORDING", help="Folder that 'capture calibrate' is writing.")],
    arm: Arm,
    until: Annotated[tuple[float, float], Option("--until", metavar="MM DEG", help="Errors that are wanted [mm] [deg].")] = (
        0.05,
        0.01,
    ),
    intrinsics: Intrinsics = None,
    lens: Lens = "auto",
    rehearse: Annotated[bool, Option("--rehearse", help="Simulate the rig instead of reading a recording.")] = False,
) -> None:
    """Advise 'capture calibrate' on its next views.

    Reads questions from the standard input and answers on the standard output, one line of JSON each. See `datasets/advice.py`.
    """
    import sys

    from koala3d.calib.advice.rehearsal import Rehearsed
    from koala3d.calib.advice.serve import Recorded, serve
    from koala3d.datasets.calibration import Calibration

    check_lens(lens)
    given = Calibration.load(intrinsics) if intrinsics is not None else None
    answer = Rehearsed(until) if rehearse else Recorded(recording, until, arm.accuracy(), given, lens)
    serve(sys.stdin, console.line, answer)


@app.command("poses", hidden=True)
@spread
def poses_command(pictures: Pictures, calibration: Intrinsics = None) -> None:
    """Find the target in each picture of a recording for 'capture repeatability'; prints one line of JSON."""
    from koala3d.calib.board_poses import board_poses
    from koala3d.datasets.recording import Recording

    found = board_poses(pictures.observe()[0], Recording.open(pictures.recording), calibration)
    console.report(found, as_json=True, text="")


app.command("export", panel=MAIN)(export_commands.export)
app.command("cameras", panel=MAIN)(together_commands.cameras)
app.command("turntable", panel=MAIN)(turntable_commands.turntable)
app.command("board", panel=MAIN)(target_commands.board)


def _show_in_rerun(calibration: "Calibration", session: "TargetSession", out: Path) -> None:
    """Write what the calibration was made from as a file for Rerun's viewer."""
    from koala3d.calib.page import rerun_calibration
    from koala3d.calib.page.evidence import gather

    rerun_calibration.write(gather(calibration, session), out)


def _check_out(out: Path) -> None:
    """Raise UsageError before the work begins if `out` cannot be written after it."""
    from koala3d.datasets.core.files import refuse_existing

    if out.is_dir():
        raise UsageError("is a folder", where=out, remedy="give --out the name of a new file")
    refuse_existing(out)


def main() -> None:
    """Entry point of the `calib` command.

    One thread is fastest for these small matrices. With several, OpenCV also sums in another order each time.
    """
    import os

    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ.setdefault(name, "1")
    console.run(app)


if __name__ == "__main__":
    main()
