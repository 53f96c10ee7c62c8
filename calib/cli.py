"""The `calib` command: parses, calls, prints."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.options import Arm, Import, JointDeg, Lens, Pictures, Rig, check_lens, spread
from datasets.core import console
from datasets.core.console import Json

if TYPE_CHECKING:
    from datasets.calibration import Calibration

app = console.make_app("calib", "Calibrate the camera and its place on the arm from a recording of a target.")

CalibrationFile = Annotated[
    Path, typer.Argument(metavar="CALIBRATION.json", help="File made by 'calib handeye' or 'calib intrinsics'.")
]
RecordingMoved = Annotated[
    Path | None, typer.Option("--recording", help="Folder that the calibration was made from; needed only if it was moved.")
]
Out = Annotated[Path, typer.Option("--out", help="Calibration file to write (JSON).")]


@app.command("intrinsics")
@spread
def intrinsics_command(pictures: Pictures, out: Out, lens: Lens = "auto", json: Json = False) -> None:
    """Camera alone: focal lengths, centre, distortion."""
    from calib.calibrate import calibrate_intrinsics

    _check_out(out)
    check_lens(lens)
    _finish(calibrate_intrinsics(pictures.observe()[0], lens), out, json)


@app.command("handeye")
@spread
def handeye_command(rig: Rig, out: Out, joint_deg: JointDeg = 0.0, json: Json = False) -> None:
    """Whole rig: camera, its place on the flange, the target's.

    Everything is estimated together, with its uncertainty, and checked on views left out of the fit.
    """
    from calib.calibrate import calibrate_handeye

    accuracy = rig.accuracy(joint_deg)
    _check_out(out)
    session, given = rig.read()
    _finish(calibrate_handeye(session, given, accuracy, rig.lens), out, json)


@app.command("compare")
@spread
def compare_command(rig: Rig, json: Json = False) -> None:
    """All hand-eye methods on one session.

    With their error on views that they have not seen; prints a table (Markdown).
    """
    from calib.study import compare

    accuracy = rig.accuracy()
    rows = compare.compare(*rig.read(), accuracy, rig.lens)
    console.report({"methods": [vars(row) for row in rows]}, as_json=json, text=compare.markdown(rows))


@app.command("verify")
@spread
def verify_command(
    pictures: Pictures,
    calibration: Annotated[Path, typer.Option("--calibration", help="Calibration file made by 'calib handeye'.")],
    json: Json = False,
) -> None:
    """How well a calibration predicts a recording.

    Best a recording that it was not made from; only the target's place is fitted.
    """
    from calib.handeye.verify import verify
    from calib.page.summary import describe_verification
    from datasets.calibration import Calibration

    result = verify(pictures.observe()[0], Calibration.load(calibration))
    console.report(result.to_json(), as_json=json, text=describe_verification(result))


@app.command("report")
def report_command(
    path: CalibrationFile,
    out: Annotated[Path, typer.Option("--out", help="HTML page to write.")],
    recording: RecordingMoved = None,
    description: Import = None,
    json: Json = False,
) -> None:
    """Write a page about a calibration.

    It shows residuals over the image, errors of each view, coverage and error ellipses. The calibration is shown as stored; the target
    is found in the recording again.
    """
    from calib.page import report
    from calib.page.evidence import gather, recording_of
    from datasets.calibration import Calibration

    _check_out(out)
    calibration = Calibration.load(path)
    session, _ = Pictures(recording=recording_of(calibration, recording), description=description).observe()
    report.write(out, gather(calibration, session), made_by=console.command_line())
    console.report({"out": str(out), "residuals": calibration.residuals}, as_json=json, text=f"written to {out}")


@app.command("view")
def view_command(path: CalibrationFile, recording: RecordingMoved = None, port: console.Port = 8080, json: Json = False) -> None:
    """Look at a calibration in the browser.

    Target and cameras, residuals over the image before and after the refinement, coverage, error ellipses.
    """
    from calib.page.view import show
    from datasets.calibration import Calibration
    from datasets.page import open_page

    calibration = Calibration.load(path)
    with open_page(path.stem, port) as page:
        show(page, calibration, recording=recording)
        rms = calibration.residuals.get("rms_px")
        console.report(
            {"url": page.url, "calibration": str(path), "rms_px": rms},
            as_json=json,
            text=f"{page.url} shows {path}; Ctrl-C ends it",
        )
        page.serve()


@app.command("plan")
@spread
def plan_command(
    rig: Rig,
    out: Annotated[Path, typer.Option("--out", help="Trajectory file to write (YAML), for 'capture plan' and 'capture run'.")],
    count: Annotated[int, typer.Option("--count", min=1, max=100, help="Number of views.")] = 5,
    grow_mm: Annotated[
        float, typer.Option("--grow-mm", min=0, help="How far beyond the recorded camera positions to go.")
    ] = 50.0,
    json: Json = False,
) -> None:
    """The next views that tell most.

    Within the box of the recorded camera positions; 'capture plan' judges whether the arm can take them.
    """
    from calib import calibrate
    from calib.study import next_views
    from datasets.recording import Recording

    accuracy = rig.accuracy()
    _check_out(out)
    session, given = rig.read()
    solution = calibrate.solve(session, given, accuracy, rig.lens)
    found = next_views.plan(solution, count, grow_m=1e-3 * grow_mm)
    manifest = Recording.open(rig.recording).manifest if "recording" in session.provenance else {}
    next_views.write_trajectory(out, found, manifest)
    (before_mm, before_deg), (after_mm, after_deg) = found.before, found.after[-1]
    text = (
        f"hand-eye pose known to {before_mm:.4f} mm, {before_deg:.5f} deg now; {after_mm:.4f} mm, {after_deg:.5f} deg expected "
        f"with {count} views more\nwritten to {out}"
    )
    console.report({"out": str(out), "before": found.before, "after": found.after}, as_json=json, text=text)


@app.command("refine")
@spread
def refine_command(
    scene: Annotated[
        Path, typer.Argument(metavar="SCENE", help="Scene made by 'datasets build', or any other that Koala reads.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Scene to write where the poses become better.")],
    arm: Arm,
    enough_px: Annotated[float, typer.Option("--enough-px", min=0, help="Poses that explain the pictures so well stay.")] = 0.5,
    json: Json = False,
) -> None:
    """Move a scene's poses to what its pictures say.

    The arm's poses are priors; moved poses are used only where points that were set aside fit better.
    """
    from calib import sfm
    from datasets.core.files import refuse_existing
    from datasets.formats import koala, load_scene

    accuracy = arm.accuracy()
    refuse_existing(out)
    found = sfm.refine_scene(load_scene(scene), prior=accuracy, enough_px=enough_px)
    if found.used:
        koala.save(found.scene, out)
    text = f"{found.reason}\n" + (
        f"poses moved by {found.moved_mm:.3f} mm, {found.moved_deg:.4f} deg rms; written to {out}"
        if found.used
        else "the poses stay; nothing is written"
    )
    console.report({"out": str(out) if found.used else None, **found.to_json()}, as_json=json, text=text)


@app.command("board")
def board_command(
    out: Annotated[Path, typer.Option("--out", help="File to write: .pdf or .svg.")],
    kind: Annotated[str, typer.Option("--kind", help="charuco, chessboard or tags.")] = "charuco",
    squares: Annotated[str, typer.Option("--squares", help="Squares along x and y.")] = "9x7",
    square_mm: Annotated[float, typer.Option("--square-mm", help="Side of a square [mm].")] = 30.0,
    marker_mm: Annotated[
        float | None, typer.Option("--marker-mm", help="Side of a marker [mm]; default: 73 % of a square.")
    ] = None,
    dictionary: Annotated[str, typer.Option("--dictionary", help="OpenCV's name of the marker dictionary.")] = "DICT_5X5_100",
    first_id: Annotated[int, typer.Option("--first-id", help="Number of the first tag.")] = 0,
    json: Json = False,
) -> None:
    """A target to print, in true size."""
    from calib.targets import printing
    from calib.targets.detection import read_board
    from datasets.core.errors import UsageError

    numbers = squares.lower().split("x")
    if len(numbers) != 2 or not all(n.isdigit() for n in numbers):
        raise UsageError("squares are given as 9x7", where="--squares", why=f"{squares!r} given")
    marker = 0.0 if kind == "chessboard" else round(0.73 * square_mm, 1) if marker_mm is None else marker_mm
    board = read_board(
        {
            "type": kind,
            "squares_x": int(numbers[0]),
            "squares_y": int(numbers[1]),
            "square_length_m": 1e-3 * square_mm,
            "marker_length_m": 1e-3 * marker,
            "dictionary": dictionary,
            "first_id": first_id,
        },
        where="board",
    )
    printing.write(board, out)
    width, height = printing.page_mm(board)
    text = f"page of {width:.0f} x {height:.0f} mm; print without fitting to the page, and measure the bar\nwritten to {out}"
    console.report({"out": str(out), "page_mm": [width, height], "board": board.to_json()}, as_json=json, text=text)


@app.command("bench")
def bench_command(
    out: Annotated[Path, typer.Option("--out", help="Folder to write: bench.csv, bench.md, bench.png.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="A few points of 40 trials: a minute instead of three quarters of an hour.")
    ] = False,
    trials: Annotated[
        int | None, typer.Option("--trials", min=2, help="Sessions per point; default 200, with --quick 40.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the noise.")] = 0,
    json: Json = False,
) -> None:
    """Run time against error of all methods.

    On simulated sessions without pictures, beside the Cramer-Rao bound.
    """
    from calib.study import bench, bench_report
    from datasets.core.files import refuse_existing

    refuse_existing(out)
    points = bench.quick_grid() if quick else bench.full_grid()
    with console.progress("measuring", len(points), "points") as bar:
        results = list(bench.run(points, trials or (40 if quick else 200), seed, done=lambda result: bar.advance()))
    bench_report.write(out, results)
    text = f"{bench_report.describe(results)}\nwritten to {out}"
    console.report({"out": str(out), **bench_report.summary(results)}, as_json=json, text=text)


@app.command("study")
def study_command(
    sessions: Annotated[int, typer.Option("--sessions", min=2, help="Simulated sessions of each kind.")] = 60,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the noise.")] = 0,
    json: Json = False,
) -> None:
    """What makes a session good: board, tilts, distances, intrinsics of their own.

    On the simulated Koala rig; prints a table (Markdown).
    """
    from calib.study import variants

    with console.progress("simulating", len(variants.VARIANTS), "kinds of session") as bar:
        outcomes = list(variants.run(sessions, seed, done=lambda outcome: bar.advance()))
    rows = [
        {
            "session": o.variant.name,
            "failures": o.failures,
            **dict(zip(("refinement", "park", "stated"), o.medians(), strict=True)),
        }
        for o in outcomes
        if len(o.refined)
    ]
    console.report({"sessions": sessions, "aim": variants.AIM, "kinds": rows}, as_json=json, text=variants.markdown(outcomes))


def _check_out(out: Path) -> None:
    """Refuse before the work what would fail after it."""
    from datasets.core.errors import UsageError
    from datasets.core.files import refuse_existing

    if out.is_dir():
        raise UsageError("is a folder", where=out, remedy="give --out the name of a JSON file")
    refuse_existing(out)


def _finish(calibration: "Calibration", out: Path, json: bool) -> None:
    """Write a calibration and say what is in it."""
    from calib.page.summary import describe_calibration, notes

    calibration.save(out)
    result: dict[str, Any] = {
        "out": str(out),
        "camera": calibration.camera.to_json(),
        "camera_std": calibration.camera_std,
        "residuals": calibration.residuals,
        "notes": notes(calibration),
    }
    for name in ("flange_from_camera", "base_from_board", "base_from_camera", "flange_from_board"):
        value = getattr(calibration, name)
        if value is not None:
            result[name] = {
                **value.to_json(),
                "translation_std_mm": value.translation_std_mm,
                "rotation_std_deg": value.rotation_std_deg,
            }
    if calibration.joint_offsets is not None:
        result["joint_offsets"] = calibration.joint_offsets.to_json()
    console.report(result, as_json=json, text=f"{describe_calibration(calibration)}\nwritten to {out}")


def main() -> None:
    """Entry point of the `calib` command. Its matrices are small: threads of the linear algebra only get in each other's way."""
    import os

    for library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(library, "1")
    console.run(app)


if __name__ == "__main__":
    main()
