"""The `capture` command, one module for each group of commands."""

from pathlib import Path

from koala3d.capture.cli import calibrate, doctor, flat, look, plan, recording, repeatability, run, sim, view
from koala3d.datasets.core import console

app = console.make_app("capture", "Move a robot and a camera along a trajectory, real or simulated, and make a recording.")


@app.command("list", panel=console.LOOK)
def list_command(as_json: console.Json = False) -> None:
    """List the installed trajectories, calibration targets, rigs and arms, and the scenes of the simulation."""
    from koala3d import configs
    from koala3d.capture.sim.laboratory.pieces import PIECES
    from koala3d.capture.sim.laboratory.scenes import SCENES

    found = {kind: configs.shipped(kind) for kind in ("trajectories", "boards", "rigs", "arms")} | {"scenes": SCENES}
    width = max(len(name) for entries in found.values() for name in entries)
    lines = []
    for kind, entries in found.items():
        lines += [f"{kind}:", *(f"  {name:{width}}  {description}" for name, description in entries.items())]
    folder = str(Path(configs.__file__).parent)
    lines.append(f"objects that are not as drawn: {', '.join(f'NAME-{piece}' for piece in PIECES)}")
    console.report({**found, "folder": folder}, as_json=as_json, text="\n".join([*lines, f"files: {folder}"]))


for panel, commands in {
    console.MAIN: (plan.plan, run.run, calibrate.calibrate),
    console.LOOK: (view.view, look.look),
    console.CHECK: (doctor.doctor, recording.check, recording.replay, repeatability.repeatability),
    console.STUDY: (flat.flat, sim.sim),
}.items():
    for command in commands:
        app.command(panel=panel)(command)


def main() -> None:
    """Entry point of the command."""
    console.run(app)
