"""The `capture` command: moves a robot and a camera along a trajectory, real or simulated."""

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

app = console.make_app("capture", "Move a robot and a camera along a trajectory, real or simulated, and make a recording.")

Trajectory = Annotated[
    Path, typer.Argument(metavar="TRAJECTORY", help="A trajectory: its name, as 'capture list' shows it, or a YAML file.")
]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a value of the trajectory: camera.binning=4.")
]
Recorded = Annotated[Path, typer.Argument(metavar="RECORDING", help="Folder that 'capture run' has written.")]
Rig = Annotated[
    str, typer.Option(metavar="RIG", help="'sim' for the simulated rig, the name of a rig ('capture list'), or a rig file.")
]
TimeScale = Annotated[float, typer.Option(min=0.1, max=1000, help="Simulation only: speed of the arm relative to real time.")]


@app.command("list")
def list_command(as_json: console.Json = False) -> None:
    """List the installed trajectories and rigs, and the scenes of the simulation."""
    import configs
    from capture.sim.laboratory.scenes import SCENES

    found = {"trajectories": configs.shipped("trajectories"), "rigs": configs.shipped("rigs"), "scenes": SCENES}
    width = max(len(name) for entries in found.values() for name in entries)
    lines = []
    for kind, entries in found.items():
        lines += [f"{kind}:", *(f"  {name:{width}}  {description}" for name, description in entries.items())]
    folder = str(Path(configs.__file__).parent)
    console.report({**found, "folder": folder}, as_json=as_json, text="\n".join([*lines, f"files: {folder}"]))


@app.command("run")
def run_command(
    trajectory: Trajectory,
    out: Annotated[Path, typer.Option(metavar="RECORDING", help="New folder to write, or with --resume an existing one.")],
    rig: Rig = "sim",
    scene: Annotated[
        str,
        typer.Option(
            help="Simulation only: what to capture: gold_head, shiny_ball, lidar_guts, crystal_capture or charuco_board. "
            "Default: a scene that fits the trajectory."
        ),
    ] = "",
    seed: Annotated[int, typer.Option(min=0, help="Simulation only: random seed; the same seed is the same rig.")] = 0,
    time_scale: TimeScale = 20.0,
    resume: Annotated[bool, typer.Option("--resume", help="Continue an interrupted recording.")] = False,
    view: Annotated[
        bool, typer.Option("--view", help="Show the session in the browser: arm, newest frame, exposure, a stop button.")
    ] = False,
    port: console.Port = 8080,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Record every view of a trajectory. Ctrl-C stops the arm and keeps the frames; --resume continues."""
    import time

    from capture import trajectory as trajectories
    from capture.planning import plan
    from capture.recording.recorder import record
    from capture.rig.opening import describe, open_rig, scene_for
    from datasets.core.errors import KoalaError
    from datasets.core.files import refuse_existing

    session = trajectories.load_trajectory(trajectory, overrides=settings)
    scene = scene_for(rig, scene, session)
    mount = describe(rig).flange_from_camera.matrix()
    if not resume:
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
        remedy = f"the same command with --resume continues in {out}" if out.exists() else "nothing was written"
        raise KoalaError(f"stopped {how}, the arm stands still", where=out, remedy=remedy) from None
    seconds = time.monotonic() - start
    found = {"recording": str(out), "frames": taken, "seconds": round(seconds, 2), "scene": scene or None}
    console.report(found, as_json=as_json, text=f"{out}: {taken} views in {seconds:.0f} s")


@app.command("plan")
def plan_command(
    trajectory: Trajectory,
    rig: Rig = "sim",
    plot: Annotated[
        Path | None, typer.Option(metavar="PLAN.png", help="Draw the plan: views and paths from two sides, joint angles.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="PLAN.html", help="Write a page that shows the plan in three dimensions.")
    ] = None,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Check that the arm can take every view, and estimate how long that takes. Nothing moves."""
    from collections import Counter

    from capture import trajectory as trajectories
    from capture.planning import Obstacles, draw, duration, plan
    from capture.rig.opening import describe
    from datasets.core.files import refuse_existing

    drawings = [(draw.plot, plot), (draw.page, page)]
    for _, path in drawings:
        if path is not None:
            refuse_existing(path)
    session = trajectories.load_trajectory(trajectory, overrides=settings)
    mount = describe(rig).flange_from_camera.matrix()
    planned = plan(session, mount)
    seconds = duration(session, planned)
    drawn = ""
    for write, path in drawings:
        if path is not None:
            title = f"{session.name}: {len(planned)} views, about {seconds:.0f} s"
            write(planned, Obstacles.of(session, mount), path, title=title)
            drawn += f"; drawn in {path}"
    splits = Counter(view.viewpoint.split for view in planned)
    parts = ", ".join(f"{count} {split}" for split, count in splits.items())
    text = f"{session.name}: all {len(planned)} views can be taken ({parts}), in about {seconds:.0f} s{drawn}"
    found = {"name": session.name, "views": len(planned), "splits": splits, "seconds": round(seconds, 1)}
    console.report({**found, "plot": plot, "page": page}, as_json=as_json, text=text)


@app.command("view")
def view_command(
    path: Annotated[
        Path, typer.Argument(metavar="TRAJECTORY|RECORDING", help="Name or file of a trajectory, or folder of a recording.")
    ],
    rig: Rig = "sim",
    port: console.Port = 8080,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Show a trajectory or a recording in the browser: arm, views, obstacles, and the session over time."""
    from capture.page.view import show
    from capture.rig.opening import describe
    from datasets.page import open_page

    with open_page(path.stem, port) as page:
        shown = show(page, path, describe(rig), overrides=settings)
        blocked = f", {shown['blocked']} cannot be taken" if shown["blocked"] else ""
        text = f"{page.url} shows {shown['name']}, {shown['views']} views{blocked}; Ctrl-C ends it"
        console.report({"url": page.url, **shown}, as_json=as_json, text=text)
        page.serve()


@app.command("check")
def check_command(
    recording: Recorded,
    discard: Annotated[
        bool,
        typer.Option("--discard", help="Remove the bad views from the recording, so that 'capture run --resume' retakes them."),
    ] = False,
    as_json: console.Json = False,
) -> None:
    """Verify a recording: hashes, counts, clocks, exposure, sharpness. Lists the views to retake; exit code 1 with findings."""
    from capture.recording import check
    from datasets.recording import Recording

    opened = Recording.open(recording)
    frames = len(opened.frames)
    with console.progress("check", frames, "views") as shown:
        findings = check.check(recording, done=lambda count, total: shown.advance())
    again = check.to_take_again(findings)
    gone = opened.discard(again) if discard else []
    good = all(finding.note for finding in findings)
    lines = [finding.line for finding in findings]
    if good:
        lines.append(f"{recording}: {frames} views, nothing is wrong")
    if again:
        lines.append(f"retake: {', '.join(again)}")
        removed = f"removed: {', '.join(gone)}; the command that made the recording retakes them with --resume"
        lines.append(removed if discard else "'capture check --discard' removes them, and 'capture run --resume' retakes them")
    found: dict[str, Any] = {"recording": str(recording), "frames": frames}
    found |= {"findings": [vars(finding) for finding in findings], "take_again": again, "discarded": gone}
    console.report(found, as_json=as_json, text="\n".join(lines))
    if not good:
        raise typer.Exit(1)


@app.command("report")
def report_command(
    recording: Recorded,
    out: Annotated[Path, typer.Option(metavar="PAGE.html", help="New page to write.")],
    as_json: console.Json = False,
) -> None:
    """Write an HTML report of a recording: findings, exposure, sharpness and joints over time, every picture."""
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
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Simulation only: random seed of the positioning errors. Default: the recording's seed plus one, which is the "
            "same arm on another day.",
        ),
    ] = None,
    time_scale: TimeScale = 20.0,
    out: Annotated[Path | None, typer.Option(metavar="FILE.json", help="Also write every deviation to a new file.")] = None,
    as_json: console.Json = False,
) -> None:
    """Repeat the joint path of a recording without the camera, and report the deviation of each frame's pose."""
    from capture.recording.replay import replay, summary
    from capture.rig.opening import open_arm
    from capture.trajectory import recorded_trajectory
    from datasets.core import files
    from datasets.recording import Recording as Recordings

    found = Recordings.open(recording)
    if out is not None:
        files.refuse_existing(out)
    recorded_seed = found.manifest.get("seed")
    recorded_seed = recorded_seed if isinstance(recorded_seed, int) else 0
    seed = recorded_seed + 1 if seed is None else seed
    trajectory = recorded_trajectory(found)
    with console.progress("replay", len(found.frames), "views") as shown:
        with open_arm(rig, trajectory, seed=seed, links_seed=recorded_seed, time_scale=time_scale) as (robot, controller):
            truth = None if controller is None else controller.true_base_from_flange
            deviations = replay(found, robot, truth=truth, advance=lambda one: shown.advance())
    content = {"recording": str(recording), **summary(deviations), "frames": [one.to_json() for one in deviations]}
    if out is not None:
        files.write_json(out, {"format": "koala-replay", "version": 1, **content})
    lines = [*(f"view {one.frame}: {one.line}" for one in deviations), f"worst: {content['worst']}"]
    console.report(content, as_json=as_json, text="\n".join(lines))


@app.command("sim")
def sim_command(
    scene: Annotated[str, typer.Option(help="Scene in front of the simulated camera, for the rig file.")] = "gold_head",
    out: Annotated[
        Path | None, typer.Option(metavar="RIG.yaml", help="Write a rig file, for 'capture run --rig RIG.yaml'.")
    ] = None,
    host: Annotated[str, typer.Option(help="Loopback address to listen on.")] = "127.0.0.1",
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    time_scale: Annotated[float, typer.Option(min=0.1, max=1000, help="Speed of the arm relative to real time.")] = 1.0,
    hangs: Annotated[
        bool, typer.Option("--hangs", help="Start in the pose of a hanging arm, for trajectories with 'up: -z'.")
    ] = False,
    as_json: console.Json = False,
) -> None:
    """Start only a simulated UR5e controller, for any RTDE client. Prints its address and ports; Ctrl-C ends it."""
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
    frames: Annotated[int, typer.Option(min=3, help="Number of frames to measure the overhead of the loop with.")] = 12,
    exposure_us: Annotated[float, typer.Option(min=100, help="Exposure time to measure the sharpness with [us].")] = 20_000.0,
    as_json: console.Json = False,
) -> None:
    """Benchmark the simulated rig: sharpness against settling time, overhead of the capture loop, rate of robot states."""
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
    console.report(found, as_json=as_json, text="\n".join([*bench.lines(found), f"{out}: bench.json, settling.png"]))


@contextmanager
def _watched(out: Path, session: "Session", mount: Any, planned: "list[PlannedView]", port: int) -> Iterator[None]:
    """A page that shows a recording while it is made. Its stop button does what Ctrl-C does."""
    import os
    import signal

    from capture.page.view import watch
    from datasets.page import open_page

    with open_page(session.name, port) as page:
        watch(page, out, session, mount, planned, stop=lambda: os.kill(os.getpid(), signal.SIGINT))
        console.hint(f"{page.url} shows the session")
        yield


def main() -> None:
    """Entry point of the command."""
    console.run(app)


if __name__ == "__main__":
    main()
