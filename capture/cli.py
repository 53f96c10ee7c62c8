"""The `capture` command: lists, plans and records. The other commands are defined beside the code that they call."""

from pathlib import Path
from typing import Annotated

from typer import Option

from capture import looking, running, viewing
from capture.calibrating import commands as calibrating_commands
from capture.doctor.commands import doctor
from capture.options import RigName, Settings, TrajectoryName
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


app.command()(running.run)
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
