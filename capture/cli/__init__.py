"""The `capture` command, one module for each group of commands."""

from pathlib import Path

from koala3d.capture.cli import calibrate, coverage, doctor, flat, look, plan, recording, rig, run, view
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


app.command()(plan.plan)
app.command()(run.run)
app.command()(calibrate.calibrate)
app.command()(coverage.coverage)
app.command()(view.view)
app.command()(recording.check)
app.command()(view.report)
app.command()(recording.replay)
app.command()(rig.sim)
app.command("test-camera")(rig.check_camera)
app.command()(doctor.doctor)
app.command()(recording.bench)
app.command("bench-calibrate")(calibrate.bench_calibrate)
app.command()(look.look)
app.command()(flat.flat)
app.command("bench-colour")(flat.bench_colour)


def main() -> None:
    """Entry point of the command."""
    console.run(app)
