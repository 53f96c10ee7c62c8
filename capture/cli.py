"""The `capture` command: lists, plans and records. The other commands are defined beside the code that they call."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from capture import looking, viewing
from capture.calibrating import commands as calibrating_commands
from capture.doctor.commands import doctor
from capture.options import RigName, Settings, TakeOver, TimeScale, TrajectoryName
from capture.radiometry import commands as radiometry_commands
from capture.recording import commands as recording_commands
from capture.rig import commands as rig_commands
from datasets.core import console

app = console.make_app("capture", "Move a robot and a camera along a trajectory, real or simulated, and make a recording.")


@app.command("list")
def list_command(as_json: console.Json = False) -> None:
    """List the installed trajectories, calibration targets, rigs and arms, and the scenes of the simulation."""
    import configs
    from capture.sim.laboratory.scenes import SCENES

    found = {kind: configs.shipped(kind) for kind in ("trajectories", "boards", "rigs", "arms")} | {"scenes": SCENES}
    width = max(len(name) for entries in found.values() for name in entries)
    lines = []
    for kind, entries in found.items():
        lines += [f"{kind}:", *(f"  {name:{width}}  {description}" for name, description in entries.items())]
    folder = str(Path(configs.__file__).parent)
    console.report({**found, "folder": folder}, as_json=as_json, text="\n".join([*lines, f"files: {folder}"]))


@app.command()
def run(
    trajectory: TrajectoryName,
    out: Annotated[Path, Option(metavar="RECORDING", help="New folder to write, or with --resume an existing one.")],
    rig: RigName = "sim",
    scene: Annotated[str, Option(help="Simulation only: a scene of 'capture list'. Default: one that fits the trajectory.")] = "",
    seed: Annotated[int, Option(min=0, help="Simulation only: random seed; the same seed is the same rig.")] = 0,
    time_scale: TimeScale = 20.0,
    radiometry: Annotated[
        Path | None,
        Option(metavar="FLAT.npz", help="File of 'capture flat' to keep with the recording. Default: the rig file's."),
    ] = None,
    resume: Annotated[bool, Option("--resume", help="Continue an interrupted recording.")] = False,
    take_over: TakeOver = False,
    view: Annotated[bool, Option("--view", help="Show the session in the browser, with a stop button.")] = False,
    port: console.Port = 8080,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Record every view of a trajectory. Ctrl-C stops the arm and keeps the frames; --resume continues."""
    import time

    from capture.doctor.examine import examination
    from capture.planning import plan
    from capture.recording.recorder import record
    from capture.rig.opening import describe, open_rig, scene_for
    from capture.trajectory import load_trajectory
    from datasets.core.errors import KoalaError
    from datasets.core.files import refuse_existing

    session = load_trajectory(trajectory, overrides=settings)
    scene = scene_for(rig, scene, session)
    mount = describe(rig).carrier()
    if not resume:
        refuse_existing(out)
    start = time.monotonic()
    planned = plan(session, mount)
    taken = 0
    options: dict[str, Any] = {"radiometry": radiometry, "take_over": take_over}
    options["examine"] = examination(out, session.upwards, session.camera.pixel_format == "rgb8", take_over)
    try:
        with ExitStack() as stack:
            if view:
                stack.enter_context(viewing.watched(out, session, mount, planned, port))
            shown = stack.enter_context(console.progress("capture", len(planned), "views"))
            with open_rig(rig, session, scene=scene, seed=seed, time_scale=time_scale, **options) as opened:

                def advance(name: str) -> None:
                    shown.advance()
                    shown.note(f"view {name}")

                taken = len(record(session, opened, out, resume=resume, planned=planned, advance=advance).frames)
    except KeyboardInterrupt:
        how = "by Ctrl-C or from the page" if view else "by Ctrl-C"
        remedy = f"the same command with --resume continues in {out}" if out.exists() else "nothing was written"
        raise KoalaError(f"stopped {how}, the arm stands still", where=out, remedy=remedy) from None
    seconds = time.monotonic() - start
    found = {"recording": str(out), "frames": taken, "seconds": round(seconds, 2), "scene": scene or None}
    console.report(found, as_json=as_json, text=f"{out}: {taken} views in {seconds:.0f} s")


@app.command("plan")
def plan_command(
    trajectory: TrajectoryName,
    rig: RigName = "sim",
    plot: Annotated[Path | None, Option(metavar="PLAN.png", help="Draw views, paths and joint angles.")] = None,
    page: Annotated[Path | None, Option(metavar="PLAN.html", help="Write a page with the plan in 3D.")] = None,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Check that the arm can take every view, and estimate how long that takes. Nothing moves."""
    from collections import Counter

    import numpy as np

    from capture.planning import Obstacles, draw, duration, plan
    from capture.rig.opening import describe
    from capture.trajectory import load_trajectory
    from datasets.core.files import refuse_existing

    drawings = [(write, path) for write, path in ((draw.plot, plot), (draw.page, page)) if path is not None]
    for _, path in drawings:
        refuse_existing(path)
    session = load_trajectory(trajectory, overrides=settings)
    mount = describe(rig).carrier()
    describe(rig).lights_on(session.lights)
    planned = plan(session, mount)
    seconds = duration(session, planned, mount.turntable)
    for write, path in drawings:
        title = f"{session.name}: {len(planned)} views, about {seconds:.0f} s"
        write(planned, Obstacles.of(session, mount), path, title=title)
    drawn = "".join(f"; drawn in {path}" for _, path in drawings)
    turns, most = float(mount.wound(np.stack([view.joints for view in planned])).max()), mount.cable and mount.cable.max_turns
    wound = f"; the cable is wound up by at most {turns:.2f} of {most:g} turns" if most else ""
    splits = Counter(view.viewpoint.split for view in planned)
    parts = ", ".join(f"{count} {split}" for split, count in splits.items())
    text = f"{session.name}: all {len(planned)} views can be taken ({parts}), in about {seconds:.0f} s{wound}{drawn}"
    found = {
        "name": session.name,
        "views": len(planned),
        "splits": splits,
        "seconds": round(seconds, 1),
        "cable_turns": round(turns, 3),
    }
    console.report({**found, "plot": plot, "page": page}, as_json=as_json, text=text)


app.command()(calibrating_commands.calibrate)
app.command()(viewing.view)
app.command()(recording_commands.check)
app.command()(viewing.report)
app.command()(recording_commands.replay)
app.command()(rig_commands.sim)
app.command("test-camera")(rig_commands.check_camera)
app.command()(doctor)
app.command()(recording_commands.bench)
app.command("bench-calibrate")(calibrating_commands.bench_calibrate)
app.command()(looking.look)
app.command()(radiometry_commands.flat)
app.command("bench-colour")(radiometry_commands.bench_colour)


def main() -> None:
    """Entry point of the command."""
    console.run(app)


if __name__ == "__main__":
    main()
