"""Commands for a finished recording: check, replay."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from koala3d.capture.cli.confirm import asker
from koala3d.capture.cli.options import CalibrationFile, Confirm, Ignore, MeshScale, Recorded, RigName, Slow, TimeScale
from koala3d.datasets.core import console

COVERAGE = "Coverage of a known shape"


def check(
    recording: Recorded,
    discard: Annotated[bool, Option("--discard", help="Remove bad views; 'capture run --resume' retakes them.")] = False,
    page: Annotated[
        Path | None,
        Option(
            "--page", metavar="PAGE.html", help="Also write an HTML report: exposure, sharpness and joints over time, pictures."
        ),
    ] = None,
    coverage: Annotated[
        Path | None,
        Option(
            "--coverage",
            metavar="MESH",
            help="Also print the share of this mesh (base frame) that three training views see at 60 degrees or less.",
            rich_help_panel=COVERAGE,
        ),
    ] = None,
    mesh_scale: MeshScale = 1.0,
    calibration: CalibrationFile = None,
    as_json: console.Json = False,
) -> None:
    """Verify a recording: hashes, counts, clocks, exposure, sharpness. Lists the views to retake; exit code 1 with findings."""
    from koala3d.capture.recording import check, session_log
    from koala3d.datasets.recording import Recording

    opened = Recording.open(recording)
    frames = len(opened.frames)
    shares, covered = [], []
    if coverage is not None:
        from koala3d.capture.sessions.adaptive import coverage as measured
        from koala3d.datasets.calibration import Calibration

        shares = measured.of_recording(recording, coverage, mesh_scale, calibration and Calibration.load(calibration))
        covered = measured.lines(shares)
    with console.progress("check", frames, "pictures") as shown:
        if page is None:
            findings = check.check(recording, done=shown.show)
        else:
            from koala3d.capture.page.report import write

            findings = write(recording, page, made_by=console.command_line(), done=shown.show)
    again = check.to_take_again(findings)
    discarded = opened.discard(again) if discard else []
    good = all(finding.note for finding in findings)
    logged = session_log.sessions(recording)
    lines = [finding.line for finding in findings] + [one.line for one in logged]
    if good:
        lines.append(f"{recording}: {frames} views, nothing is wrong")
    if again:
        lines.append(f"retake: {', '.join(again)}")
        removed = f"removed: {', '.join(discarded)}; the command that made the recording retakes them with --resume"
        lines.append(removed if discard else "'capture check --discard' removes them, and 'capture run --resume' retakes them")
    found: dict[str, Any] = {"recording": str(recording), "frames": frames, "page": page, "covered_after": shares}
    found |= {"findings": [vars(finding) for finding in findings], "take_again": again, "discarded": discarded}
    found |= {"sessions": [vars(one) for one in logged]}
    console.report(found, as_json=as_json, text="\n".join([*lines, *covered, *([str(page)] if page is not None else [])]))
    if not good:
        raise typer.Exit(1)


def replay(
    recording: Recorded,
    rig: RigName = "sim",
    seed: Annotated[
        int | None,
        Option(min=0, help="Simulation only: seed of the positioning errors. Default: the recording's plus one: a new day."),
    ] = None,
    time_scale: TimeScale = 20.0,
    slow: Slow = 1.0,
    confirm: Confirm = False,
    out: Annotated[Path | None, Option(metavar="FILE.json", help="Also write every deviation to a new file.")] = None,
    ignore: Ignore = None,
    as_json: console.Json = False,
) -> None:
    """Repeat the joint path of a recording without the camera, and report the deviation of each frame's pose.

    It is what the arm's own encoders see. What they do not see, 'capture repeatability' measures by pictures.

    The arm and its mount must be those of the recording. The path is planned around what the rig file says of its surroundings.
    """
    from koala3d.capture.doctor.examine import examination
    from koala3d.capture.model.trajectory import recorded_trajectory
    from koala3d.capture.recording.replay import obstacles_around, replay, summary
    from koala3d.capture.rig.arms import open_arm
    from koala3d.capture.rig.controllers import host_of
    from koala3d.capture.rig.links import reported_links
    from koala3d.capture.rig.moves import Moves
    from koala3d.capture.rig.naming import describe
    from koala3d.datasets.core import files
    from koala3d.datasets.recording import Recording

    found = Recording.open(recording)
    if out is not None:
        files.refuse_existing(out)
    stated = found.manifest.get("seed")
    links_seed = stated if isinstance(stated, int) else 0
    seed, trajectory = links_seed + 1 if seed is None else seed, recorded_trajectory(found)
    description = describe(rig)
    obstacles, moves = obstacles_around(found, description), Moves(slow, asker(confirm), console.hint)
    examine = examination(Path.cwd(), trajectory.upwards, ignore=ignore or (), cameras=False)
    options: dict[str, Any] = {"seed": seed, "links_seed": links_seed, "time_scale": time_scale, "examine": examine}
    with console.progress("replay", len(found.frames), "views") as shown:
        with open_arm(rig, trajectory, **options) as (robot, controller):
            truth = None if controller is None else controller.true_base_from_flange
            obstacles = obstacles.as_built(reported_links(description, host_of(description, controller)))
            deviations = replay(found, robot, obstacles, truth=truth, moves=moves, advance=lambda one: shown.advance())
    content = {"recording": str(recording), **summary(deviations), "frames": [vars(one) for one in deviations]}
    if out is not None:
        files.write_json(out, {"format": "koala-replay", "version": 1, **content})
    lines = [*(f"view {one.frame}: {one.line}" for one in deviations), f"worst: {content['worst']}, by the arm's own encoders"]
    console.report(content, as_json=as_json, text="\n".join(lines))
