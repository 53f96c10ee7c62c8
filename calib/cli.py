"""The `calib` command: parses, calls, prints."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from koala3d.calib import drawing
from koala3d.calib.options import (
    AllowMm,
    Arm,
    Import,
    Inexact,
    Intrinsics,
    Lens,
    Pictures,
    Rig,
    allowed_m,
    check_lens,
    spread,
)
from koala3d.calib.targets import commands as target_commands
from koala3d.calib.together import commands as together_commands
from koala3d.calib.turntable import commands as turntable_commands
from koala3d.datasets.core import console
from koala3d.datasets.core.console import Json
from koala3d.datasets.core.errors import UsageError

app = console.make_app("calib", "Calibrate the camera and its pose on the arm from a recording of a target.")

CalibrationFile = Annotated[
    Path, Argument(metavar="CALIBRATION.json", help="File made by 'calib handeye' or 'calib intrinsics'.")
]
RecordingMoved = Annotated[Path | None, Option("--recording", help="Folder that the calibration was made from, if it was moved.")]
Out = Annotated[Path, Option("--out", help="Calibration file to write (JSON).")]


@app.command("intrinsics")
@spread
def intrinsics_command(pictures: Pictures, out: Out, lens: Lens = "auto", json: Json = False) -> None:
    """Calibrate the camera alone: focal lengths, principal point, distortion."""
    from koala3d.calib.calibrate import calibrate_intrinsics
    from koala3d.calib.page.finish import finish

    _check_out(out)
    check_lens(lens)
    finish(calibrate_intrinsics(pictures.observe()[0], lens), out, json)


@app.command("handeye")
@spread
def handeye_command(
    rig: Rig,
    inexact: Inexact,
    out: Out,
    allow_mm: AllowMm = 5.0,
    json: Json = False,
) -> None:
    """Calibrate the whole rig: the camera, its pose on the flange and the pose of the target.

    Everything is estimated together, with its uncertainty, and tested on views held out of the fit.
    """
    from koala3d.calib.calibrate import calibrate_handeye
    from koala3d.calib.page.finish import finish

    accuracy, allow_m = rig.accuracy(inexact), allowed_m(allow_mm)
    _check_out(out)
    session, given = rig.read()
    finish(calibrate_handeye(session, given, accuracy, rig.lens, allow_m), out, json)


@app.command("compare")
@spread
def compare_command(rig: Rig, json: Json = False) -> None:
    """Compare all hand-eye methods on one session.

    Prints a table (Markdown) with the error of each method on views held out of its fit.
    """
    from koala3d.calib import comparison

    accuracy = rig.accuracy()
    rows = comparison.compare(*rig.read(), accuracy, rig.lens)
    console.report({"methods": [vars(row) for row in rows]}, as_json=json, text=comparison.markdown(rows))


@app.command("verify")
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

    result = verify(pictures.observe()[0], Calibration.load(calibration))
    console.report(result.to_json(), as_json=json, text=describe_verification(result))


@app.command("report")
def report_command(
    path: CalibrationFile,
    out: Annotated[Path, Option("--out", help="HTML page to write.")],
    recording: RecordingMoved = None,
    description: Import = None,
    json: Json = False,
) -> None:
    """Write a page about a calibration.

    It shows residuals over the image, errors of each view, coverage and error ellipses. The calibration is shown as stored.
    The recording is searched for the target again.
    """
    from koala3d.calib.page import report
    from koala3d.calib.page.evidence import gather, recording_of
    from koala3d.datasets.calibration import Calibration

    _check_out(out)
    calibration = Calibration.load(path)
    leave_out = calibration.provenance.get("leave_out") is True
    found = Pictures(recording=recording_of(calibration, recording), description=description, leave_out=leave_out)
    session, _ = found.observe()
    report.page(gather(calibration, session), made_by=console.command_line()).write(out)
    console.report({"out": str(out), "residuals": calibration.residuals}, as_json=json, text=f"written to {out}")


@app.command("view")
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
        rms = calibration.residuals.get("rms_px")
        result = {"url": page.url, "calibration": str(path), "rms_px": rms}
        console.report(result, as_json=json, text=f"{page.url} shows {path}; Ctrl-C ends it")
        page.serve()


@app.command("plan")
@spread
def plan_command(
    rig: Rig,
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


@app.command("advise")
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


@app.command("refine")
@spread
def refine_command(
    scene: Annotated[Path, Argument(metavar="SCENE", help="Scene made by 'datasets build', or any other that Koala reads.")],
    out: Annotated[Path, Option("--out", help="Scene to write if the poses improve.")],
    arm: Arm,
    enough_px: Annotated[float, Option("--enough-px", min=0, help="Keep poses whose median error is below this [px].")] = 0.5,
    json: Json = False,
) -> None:
    """Refine the camera poses of a scene by bundle adjustment.

    The arm's poses are priors. Refined poses are used only if they explain held-out points better.
    """
    from koala3d.calib import sfm
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.datasets.formats import koala, load_scene

    accuracy = arm.accuracy()
    refuse_existing(out)
    found = sfm.refine_scene(load_scene(scene), prior=accuracy, enough_px=enough_px)
    if found.used:
        koala.save(found.scene, out)
    moved = f"poses moved by {found.moved_mm:.3f} mm, {found.moved_deg:.4f} deg rms; written to {out}"
    text = f"{found.reason}\n{moved if found.used else 'the poses are unchanged; nothing is written'}"
    console.report({"out": str(out) if found.used else None, **found.to_json()}, as_json=json, text=text)


app.command("uncertainty")(drawing.uncertainty)


app.command("difference")(drawing.difference)


app.command("cameras")(together_commands.cameras)


app.command("boards")(together_commands.boards)


app.command("turntable")(turntable_commands.turntable)


app.command("board")(target_commands.board)


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
