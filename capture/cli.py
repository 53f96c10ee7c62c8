"""The `capture` command: takes a robot and a camera along a trajectory, real or simulated."""

from pathlib import Path
from typing import Annotated, Any

import typer

from datasets import console

app = console.make_app("capture", "Take a robot and a camera along a trajectory, real or simulated, and leave a recording.")

Trajectory = Annotated[Path, typer.Argument(metavar="TRAJECTORY.yaml", help="What to take; see configs/trajectories/.")]
Rig = Annotated[str, typer.Option(metavar="sim|RIG.yaml", help="The simulated rig, or the file that describes yours.")]


@app.command("run")
def run_command(
    trajectory: Trajectory,
    out: Annotated[Path, typer.Option(metavar="RECORDING", help="Folder to write; new, or with --resume begun before.")],
    rig: Rig = "sim",
    scene: Annotated[str, typer.Option(help="Simulation: what to look at: gold_head, shiny_ball or charuco_board. "
                                            "Default: what suits the trajectory.")] = "",
    seed: Annotated[int, typer.Option(min=0, help="Simulation: of everything random; the same seed is the same rig.")] = 0,
    time_scale: Annotated[float, typer.Option(min=0.1, max=1000, help="Simulation: arm faster than real time.")] = 20.0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a recording that was stopped.")] = False,
    as_json: console.Json = False,
) -> None:  # fmt: skip
    """Record every view of a trajectory. Ctrl-C stops the arm and keeps what was taken; --resume goes on."""
    import time

    from capture import trajectory as trajectories
    from capture.planning import plan
    from capture.recorder import record
    from capture.rigs import describe, open_rig, scene_for
    from datasets.errors import KoalaError

    session = trajectories.load_trajectory(trajectory)
    scene = scene_for(rig, scene, session)
    mount = describe(rig).flange_from_camera.matrix()
    if not resume:
        from datasets.files import refuse_existing

        refuse_existing(out)
    start = time.monotonic()
    planned = plan(session, mount)
    taken = 0
    try:
        with console.progress("capture", len(planned), "views") as shown:
            with open_rig(rig, session, scene=scene, seed=seed, time_scale=time_scale) as opened:

                def advance(name: str) -> None:
                    shown.advance()
                    shown.note(f"view {name}")

                recording = record(session, opened, out, resume=resume, planned=planned, advance=advance)
                taken = len(recording.frames)
    except KeyboardInterrupt:
        raise KoalaError("stopped by Ctrl-C, the arm stands still", where=out, remedy=_how_to_resume(out)) from None
    seconds = time.monotonic() - start
    console.report({"recording": str(out), "frames": taken, "seconds": round(seconds, 2), "scene": scene or None}, as_json=as_json,
                   text=f"{out}: {taken} views in {seconds:.0f} s")  # fmt: skip


@app.command("plan")
def plan_command(trajectory: Trajectory, rig: Rig = "sim", as_json: console.Json = False) -> None:
    """Check that the arm can take every view, and say how long it would take. Moves nothing."""
    from capture import trajectory as trajectories
    from capture.planning import plan
    from capture.rigs import describe

    session = trajectories.load_trajectory(trajectory)
    planned = plan(session, describe(rig).flange_from_camera.matrix())
    seconds = _duration(session, planned)
    counts: dict[str, Any] = {}
    for view in planned:
        counts[view.viewpoint.split] = counts.get(view.viewpoint.split, 0) + 1
    parts = ", ".join(f"{count} {split}" for split, count in counts.items())
    console.report({"name": session.name, "views": len(planned), "splits": counts, "seconds": round(seconds, 1)}, as_json=as_json,
                   text=f"{session.name}: all {len(planned)} views can be taken ({parts}), in about {seconds:.0f} s")  # fmt: skip


def _duration(session: Any, planned: list[Any]) -> float:
    """Time on the real arm [s]: trapezoidal moves between the views, settling and exposures."""
    import numpy as np

    motion, seconds, previous = session.motion, 0.0, None
    for view in planned:
        for joints in view.way:
            travel = 0.0 if previous is None else float(np.abs(joints - previous).max())
            ramp = motion.speed**2 / motion.acceleration
            seconds += 2 * np.sqrt(travel / motion.acceleration) if travel < ramp else (travel + ramp) / motion.speed
            previous = joints
        seconds += motion.settle_time_s + session.camera.exposure_us * 1e-6 + 0.1
    return float(seconds)


def _how_to_resume(out: Path) -> str:
    return f"the same command with --resume goes on in {out}" if out.exists() else "nothing was written"


def main() -> None:
    """Entry point of the command."""
    console.run(app)


if __name__ == "__main__":
    main()
