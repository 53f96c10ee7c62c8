"""Commands for a finished recording, and the benchmark of the capture loop: check, replay, bench."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from koala3d.capture.cli.options import Recorded, RigName, TimeScale
from koala3d.datasets.core import console


def check(
    recording: Recorded,
    discard: Annotated[bool, Option("--discard", help="Remove bad views; 'capture run --resume' retakes them.")] = False,
    as_json: console.Json = False,
) -> None:
    """Verify a recording: hashes, counts, clocks, exposure, sharpness. Lists the views to retake; exit code 1 with findings."""
    from koala3d.capture.recording import check
    from koala3d.datasets.recording import Recording

    opened = Recording.open(recording)
    frames = len(opened.frames)
    with console.progress("check", frames, "views") as shown:
        findings = check.check(recording, done=shown.show)
    again = check.to_take_again(findings)
    discarded = opened.discard(again) if discard else []
    good = all(finding.note for finding in findings)
    lines = [finding.line for finding in findings]
    if good:
        lines.append(f"{recording}: {frames} views, nothing is wrong")
    if again:
        lines.append(f"retake: {', '.join(again)}")
        removed = f"removed: {', '.join(discarded)}; the command that made the recording retakes them with --resume"
        lines.append(removed if discard else "'capture check --discard' removes them, and 'capture run --resume' retakes them")
    found: dict[str, Any] = {"recording": str(recording), "frames": frames}
    found |= {"findings": [vars(finding) for finding in findings], "take_again": again, "discarded": discarded}
    console.report(found, as_json=as_json, text="\n".join(lines))
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
    out: Annotated[Path | None, Option(metavar="FILE.json", help="Also write every deviation to a new file.")] = None,
    as_json: console.Json = False,
) -> None:
    """Repeat the joint path of a recording without the camera, and report the deviation of each frame's pose."""
    from koala3d.capture.model.trajectory import recorded_trajectory
    from koala3d.capture.recording.replay import replay, summary
    from koala3d.capture.rig.arms import open_arm
    from koala3d.datasets.core import files
    from koala3d.datasets.recording import Recording

    found = Recording.open(recording)
    if out is not None:
        files.refuse_existing(out)
    stated = found.manifest.get("seed")
    links_seed = stated if isinstance(stated, int) else 0
    seed, trajectory = links_seed + 1 if seed is None else seed, recorded_trajectory(found)
    with console.progress("replay", len(found.frames), "views") as shown:
        with open_arm(rig, trajectory, seed=seed, links_seed=links_seed, time_scale=time_scale) as (robot, controller):
            truth = None if controller is None else controller.true_base_from_flange
            deviations = replay(found, robot, truth=truth, advance=lambda one: shown.advance())
    content = {"recording": str(recording), **summary(deviations), "frames": [vars(one) for one in deviations]}
    if out is not None:
        files.write_json(out, {"format": "koala-replay", "version": 1, **content})
    lines = [*(f"view {one.frame}: {one.line}" for one in deviations), f"worst: {content['worst']}"]
    console.report(content, as_json=as_json, text="\n".join(lines))


def bench(
    out: Annotated[Path, Option(metavar="FOLDER", help="New folder for bench.json and settling.png.")],
    frames: Annotated[int, Option(min=3, help="Number of frames to measure the overhead of the loop with.")] = 12,
    exposure_us: Annotated[float, Option(min=100, help="Exposure time to measure the sharpness with [us].")] = 20_000.0,
    as_json: console.Json = False,
) -> None:
    """Benchmark the simulated rig: sharpness against settling time, overhead of the capture loop, rate of robot states."""
    from koala3d.capture.recording import bench
    from koala3d.datasets.core import files

    files.refuse_existing(out)
    with console.progress("bench", 1 + frames + len(bench.DELAYS_S), "steps") as shown:
        rate = bench.state_rate()
        shown.advance()
        overheads = bench.loop_overhead(frames, advance=lambda name: shown.advance())
        points = bench.settle_curve(exposure_us=exposure_us, advance=lambda name: shown.advance())
    found = bench.summary(points, overheads, rate)
    with files.atomic_folder(out) as folder:
        files.write_json(folder / "bench.json", {"format": "koala-capture-bench", "version": 1, **found})
        bench.plot_settling(points, folder / "settling.png")
    console.report(found, as_json=as_json, text="\n".join([*bench.lines(found), f"{out}: bench.json, settling.png"]))
