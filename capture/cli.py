"""The `capture` command: lists, plans and records. The other commands are defined beside the code that they call."""

from pathlib import Path

from koala3d.capture import looking, plans, running, viewing
from koala3d.capture.calibrating import commands as calibrating_commands
from koala3d.capture.choosing import commands as choosing_commands
from koala3d.capture.doctor.commands import doctor
from koala3d.capture.radiometry import commands as radiometry_commands
from koala3d.capture.recording import commands as recording_commands
from koala3d.capture.rig import commands as rig_commands
from koala3d.datasets.core import console

app = console.make_app("capture", "Move a robot and a camera along a trajectory, real or simulated, and make a recording.")


@app.command("list")
def list_command(as_json: console.Json = False) -> None:
    """List the installed trajectories, calibration targets, rigs and arms, and the scenes of the simulation."""
    from koala3d import configs
    from koala3d.capture.sim.laboratory.scenes import SCENES

    found = {kind: configs.shipped(kind) for kind in ("trajectories", "boards", "rigs", "arms")} | {"scenes": SCENES}
    width = max(len(name) for entries in found.values() for name in entries)
    lines = []
    for kind, entries in found.items():
        lines += [f"{kind}:", *(f"  {name:{width}}  {description}" for name, description in entries.items())]
    folder = str(Path(configs.__file__).parent)
    console.report({**found, "folder": folder}, as_json=as_json, text="\n".join([*lines, f"files: {folder}"]))


app.command()(plans.plan)
app.command()(running.run)
app.command()(calibrating_commands.calibrate)
app.command()(choosing_commands.coverage)
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
