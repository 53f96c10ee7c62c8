"""The `capture` command: takes a robot and a camera along a trajectory, real or simulated."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capture.errors import SimulationError
from datasets.core import console

if TYPE_CHECKING:
    from capture.planning import PlannedView
    from capture.trajectory import Trajectory as Session

app = console.make_app("capture", "Take a robot and a camera along a trajectory, real or simulated, and leave a recording.")

Trajectory = Annotated[Path, typer.Argument(metavar="TRAJECTORY.yaml", help="What to take; see configs/trajectories/.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change the trajectory: camera.binning=4.")
]
Recorded = Annotated[Path, typer.Argument(metavar="RECORDING", help="Folder that 'capture run' has left.")]
Rig = Annotated[str, typer.Option(metavar="sim|RIG.yaml", help="The simulated rig, or the file that describes yours.")]


@app.command("run")
def run_command(
    trajectory: Trajectory,
    out: Annotated[Path, typer.Option(metavar="RECORDING", help="Folder to write; new, or with --resume begun before.")],
    rig: Rig = "sim",
    scene: Annotated[str, typer.Option(help="Simulation: what to look at: gold_head, shiny_ball, lidar_guts, crystal_capture "
                                            "or charuco_board. Default: what suits the trajectory.")] = "",
    seed: Annotated[int, typer.Option(min=0, help="Simulation: of everything random; the same seed is the same rig.")] = 0,
    time_scale: Annotated[float, typer.Option(min=0.1, max=1000, help="Simulation: arm faster than real time.")] = 20.0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a recording that was stopped.")] = False,
    view: Annotated[bool, typer.Option("--view", help="Show it in the browser meanwhile: arm, newest frame, exposure, a stop button.")] = False,
    port: console.Port = 8080,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:  # fmt: skip
    """Record every view of a trajectory. Ctrl-C stops the arm and keeps what was taken; --resume goes on."""
    import time

    from capture import trajectory as trajectories
    from capture.planning import plan
    from capture.recording.recorder import record
    from capture.rig.opening import describe, open_rig, scene_for
    from datasets.core.errors import KoalaError

    session = trajectories.load_trajectory(trajectory, overrides=settings)
    scene = scene_for(rig, scene, session)
    mount = describe(rig).flange_from_camera.matrix()
    if not resume:
        from datasets.core.files import refuse_existing

        refuse_existing(out)
    start = time.monotonic()
    planned = plan(session, mount)
    taken = 0
    try:
        with ExitStack() as stack:
            if view:
                stack.enter_context(_watched(out, session, mount, planned, port))
            shown = stack.enter_context(console.progress("capture", len(planned), "views"))
            with open_rig(rig, session, scene=scene, seed=seed, time_scale=time_scale) as opened:

                def advance(name: str) -> None:
                    shown.advance()
                    shown.note(f"view {name}")

                recording = record(session, opened, out, resume=resume, planned=planned, advance=advance)
                taken = len(recording.frames)
    except KeyboardInterrupt:
        how = "by Ctrl-C or from the page" if view else "by Ctrl-C"
        raise KoalaError(f"stopped {how}, the arm stands still", where=out, remedy=_how_to_resume(out)) from None
    seconds = time.monotonic() - start
    console.report({"recording": str(out), "frames": taken, "seconds": round(seconds, 2), "scene": scene or None}, as_json=as_json,
                   text=f"{out}: {taken} views in {seconds:.0f} s")  # fmt: skip


@app.command("plan")
def plan_command(
    trajectory: Trajectory,
    rig: Rig = "sim",
    plot: Annotated[
        Path | None, typer.Option(metavar="PLAN.png", help="Draw it: views and ways from two sides, joint angles.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="PLAN.html", help="Draw it in three dimensions, to turn with the mouse.")
    ] = None,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Check that the arm can take every view, and say how long it would take. Moves nothing."""
    from capture import trajectory as trajectories
    from capture.planning import Obstacles, draw, duration, plan
    from capture.rig.opening import describe
    from datasets.core.files import refuse_existing

    for path in (plot, page):
        if path is not None:
            refuse_existing(path)
    session = trajectories.load_trajectory(trajectory, overrides=settings)
    mount = describe(rig).flange_from_camera.matrix()
    planned = plan(session, mount)
    seconds = duration(session, planned)
    obstacles = Obstacles.of(session, mount)
    if plot is not None:
        draw.plot(planned, obstacles, plot, title=f"{session.name}: {len(planned)} views, about {seconds:.0f} s")
    if page is not None:
        draw.page(planned, obstacles, page, title=f"{session.name}: {len(planned)} views, about {seconds:.0f} s")
    counts: dict[str, Any] = {}
    for view in planned:
        counts[view.viewpoint.split] = counts.get(view.viewpoint.split, 0) + 1
    parts = ", ".join(f"{count} {split}" for split, count in counts.items())
    drawn = "".join(f"; drawn in {path}" for path in (plot, page) if path is not None)
    found = {
        "name": session.name,
        "views": len(planned),
        "splits": counts,
        "seconds": round(seconds, 1),
        "plot": plot,
        "page": page,
    }
    console.report(found, as_json=as_json,
                   text=f"{session.name}: all {len(planned)} views can be taken ({parts}), in about {seconds:.0f} s{drawn}")  # fmt: skip


@app.command("view")
def view_command(
    path: Annotated[Path, typer.Argument(metavar="TRAJECTORY.yaml|RECORDING", help="What to look at: a file or a folder.")],
    rig: Rig = "sim",
    port: console.Port = 8080,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Look at a trajectory or a recording in the browser: arm, views, what is in the way, and the session over time."""
    from capture.page.view import show
    from capture.rig.opening import describe
    from datasets.page import open_page

    with open_page(path.stem, port) as page:
        shown = show(page, path, describe(rig), overrides=settings)
        stuck = f", {shown['blocked']} cannot be taken" if shown["blocked"] else ""
        console.report({"url": page.url, **shown}, as_json=as_json,
                       text=f"{page.url} shows {shown['name']}, {shown['views']} views{stuck}; Ctrl-C ends it")  # fmt: skip
        page.serve()


@app.command("check")
def check_command(
    recording: Recorded,
    discard: Annotated[bool, typer.Option("--discard", help="Take what is to be taken again out of the recording, so that "
                                                            "'capture run --resume' takes it again.")] = False,
    as_json: console.Json = False,
) -> None:  # fmt: skip
    """Verify a recording: hashes, counts, clocks, exposure, sharpness. Says what to take again; exit code 1 with findings."""
    from capture.recording import check
    from datasets.recording import Recording

    frames = len(Recording.open(recording).frames)
    with console.progress("check", frames, "views") as shown:
        findings = check.check(recording, done=lambda count, total: shown.advance())
    again = check.to_take_again(findings)
    gone = check.discard(recording, again) if discard else []
    lines = [finding.line for finding in findings]
    if all(finding.note for finding in findings):
        lines.append(f"{recording}: {frames} views, nothing is wrong")
    if again:
        lines.append(f"take again: {', '.join(again)}")
        lines.append(f"taken out: {', '.join(gone)}; the command that made the recording takes them again with --resume"
                     if discard else "'capture check --discard' takes them out, then 'capture run --resume' takes them again")  # fmt: skip
    found = {"recording": str(recording), "frames": frames, "findings": [vars(finding) for finding in findings],
             "take_again": again, "discarded": gone}  # fmt: skip
    console.report(found, as_json=as_json, text="\n".join(lines))
    if not all(finding.note for finding in findings):
        raise typer.Exit(1)


@app.command("report")
def report_command(
    recording: Recorded,
    out: Annotated[Path, typer.Option(metavar="PAGE.html", help="Page to write; must be new.")],
    as_json: console.Json = False,
) -> None:
    """Write a page on a recording: findings, exposure, sharpness and joints over time, every view."""
    from capture.page import report

    with console.progress("reading", 1, "pictures") as shown:

        def advance(count: int, total: int) -> None:
            shown.total = total
            shown.advance(count - shown.done)

        findings = report.write(recording, out, made_by=console.command_line(), done=advance)
    wrong = sum(not finding.note for finding in findings)
    console.report({"out": str(out), "findings": wrong}, as_json=as_json, text=f"{wrong} findings\n{out}")


@app.command("replay")
def replay_command(
    recording: Recorded,
    rig: Rig = "sim",
    seed: Annotated[int | None, typer.Option(min=0, help="Simulation: of the arm's errors. Default: one more than that of the "
                                                         "recording, the same arm on another day.")] = None,
    time_scale: Annotated[float, typer.Option(min=0.1, max=1000, help="Simulation: arm faster than real time.")] = 20.0,
    out: Annotated[Path | None, typer.Option(metavar="FILE.json", help="Also write every deviation to a new file.")] = None,
    as_json: console.Json = False,
) -> None:  # fmt: skip
    """Drive the joint path of a recording again, without the camera, and report how far each frame's pose is from it."""
    from capture.recording.replay import replay, summary
    from capture.rig.opening import open_arm
    from capture.trajectory import Trajectory
    from datasets.core import files
    from datasets.recording import Recording as Recordings

    found = Recordings.open(recording)
    if out is not None:
        files.refuse_existing(out)
    recorded_seed = int(found.manifest.get("seed") or 0)
    seed = recorded_seed + 1 if seed is None else seed
    trajectory = Trajectory.model_validate(found.trajectory)
    with console.progress("replay", len(found.frames), "views") as shown:
        with open_arm(rig, trajectory, seed=seed, links_seed=recorded_seed, time_scale=time_scale) as (robot, controller):
            truth = None if controller is None else controller.true_base_from_flange
            deviations = replay(found, robot, truth=truth, advance=lambda one: shown.advance())
    content = {"recording": str(recording), **summary(deviations), "frames": [one.to_json() for one in deviations]}
    if out is not None:
        files.write_json(out, {"format": "koala-replay", "version": 1, **content})
    lines = [f"view {one.frame}: {one.line}" for one in deviations]
    console.report(content, as_json=as_json, text="\n".join([*lines, f"worst: {content['worst']}"]))


@app.command("sim")
def sim_command(
    scene: Annotated[str, typer.Option(help="What stands before the simulated camera, for the rig file.")] = "gold_head",
    out: Annotated[Path | None, typer.Option(metavar="RIG.yaml", help="Write a rig file: 'capture run --rig RIG.yaml' uses it.")] = None,
    host: Annotated[str, typer.Option(help="Loopback address to listen on.")] = "127.0.0.1",
    seed: Annotated[int, typer.Option(min=0, help="Of everything random.")] = 0,
    time_scale: Annotated[float, typer.Option(min=0.1, max=1000, help="Arm faster than real time.")] = 1.0,
    hangs: Annotated[bool, typer.Option("--hangs", help="It waits as an arm that hangs, for trajectories with 'up: -z'.")] = False,
    as_json: console.Json = False,
) -> None:  # fmt: skip
    """Start a simulated UR5e controller by itself, for any RTDE client. Prints its address and ports; Ctrl-C ends it."""
    import time

    from capture.rig.opening import write_simulated_rig
    from capture.sim.controller.process import SimulatedController
    from capture.sim.controller.server import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORT
    from capture.sim.laboratory.scenes import check_name

    check_name(scene)
    with SimulatedController.as_built(seed=seed, time_scale=time_scale, hangs=hangs, host=host) as controller:
        if out is not None:
            write_simulated_rig(out, controller, scene, seed)
        ports = {"rtde": RTDE_PORT, "script": SCRIPT_PORT, "dashboard": DASHBOARD_PORT, "side_channel": controller.side_port}
        hint = f"; rig file: {out}" if out is not None else ""
        text = f"UR5e at {controller.host}: {', '.join(f'{name} {port}' for name, port in ports.items())}{hint}. Ctrl-C ends it"
        console.report({"host": controller.host, "ports": ports, "scene": scene, "rig": out}, as_json=as_json, text=text)
        try:
            while controller.process.poll() is None:
                time.sleep(0.2)
        except KeyboardInterrupt:
            return
        raise SimulationError("the simulated controller has ended", why=controller.last_words(), remedy="start it again")


@app.command("bench")
def bench_command(
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="New folder for bench.json and settling.png.")],
    frames: Annotated[int, typer.Option(min=3, help="For the loop's overhead.")] = 12,
    exposure_us: Annotated[float, typer.Option(min=100, help="For the sharpness [us].")] = 20_000.0,
    as_json: console.Json = False,
) -> None:
    """Measure on the simulated rig: sharpness against settling time, overhead of the loop, rate of states."""
    from capture.recording import bench
    from datasets.core import files

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
    rows = [f"  {1e3 * p.delay_s:5.0f} ms: sharpness {100 * p.sharpness:5.1f} %, camera {p.off_mm:.3f} mm off" for p in points]
    console.report(found, as_json=as_json, text="\n".join([
        f"states: {rate:.0f} Hz", f"overhead: median {found['overhead_ms']['median']:.1f} ms, worst {found['overhead_ms']['worst']:.1f} ms",
        "exposed after the end of the motion:", *rows, f"{out}: bench.json, settling.png"]))  # fmt: skip


@contextmanager
def _watched(out: Path, session: "Session", mount: Any, planned: "list[PlannedView]", port: int) -> Iterator[None]:
    """A page on a recording that is about to be made, for as long as it takes. Its button does what Ctrl-C does."""
    import os
    import signal

    from capture.page.view import watch
    from datasets.page import open_page

    with open_page(session.name, port) as page:
        watch(page, out, session, mount, planned, stop=lambda: os.kill(os.getpid(), signal.SIGINT))
        console.hint(f"{page.url} shows what is being taken")
        yield


def _how_to_resume(out: Path) -> str:
    return f"the same command with --resume goes on in {out}" if out.exists() else "nothing was written"


def main() -> None:
    """Entry point of the command."""
    console.run(app)


if __name__ == "__main__":
    main()
