"""The command that finds the axis of a turntable: `calib turntable`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from koala3d.datasets.core import console
from koala3d.datasets.core.errors import UsageError

if TYPE_CHECKING:
    from koala3d.calib.turntable.axis import FoundAxis

SURE = 4.0  # standard deviations from which on a difference of the gear is worth a note


def turntable(
    recording: Annotated[
        Path, Argument(metavar="RECORDING", help="Folder made by 'capture run' with a target that turned on the table.")
    ],
    calibration: Annotated[Path, Option("--calibration", help="Calibration file of the same rig, with a hand-eye pose.")],
    out: Annotated[Path, Option("--out", help="Calibration file to write (JSON): the given one, with the axis.")],
    json: console.Json = False,
) -> None:
    """Find the axis of a turntable from pictures of a target that stands on it while it turns."""
    from dataclasses import replace

    import numpy as np

    from koala3d.calib.handeye.verify import check_size
    from koala3d.calib.sessions.session import observe_recording
    from koala3d.calib.turntable.axis import find
    from koala3d.datasets.calibration import Calibration
    from koala3d.datasets.core import files
    from koala3d.datasets.recording import FRAMES, Recording

    files.refuse_existing(out)
    given, opened = Calibration.load(calibration), Recording.open(recording)
    if not opened.turns:
        remedy = "record calibration_turntable with a rig that has one"
        raise UsageError("recording shows no turntable that turned", where=recording, remedy=remedy)
    with console.progress("finding the target", len(opened.frames), "views") as bar:

        def seen(words: str) -> None:
            bar.note(words)
            bar.advance()

        session = observe_recording(recording, seen=seen)
    check_size(session, given.camera)
    angles = {frame.name: frame.turntable_angle or 0.0 for frame in opened.frames}
    found = find(session, np.array([angles[one.name] for one in session.observations]), given)
    facts = {
        "recording": str(recording.resolve()),
        "frames_sha256": files.sha256(recording / FRAMES),
        "rms_px": found.rms_px,
        "views_used": len(found.view_rms_px),
        "views_unseen": list(session.unseen),
        "corners": found.corners,
        "turned_per_reported": found.scale,
        "turned_per_reported_std": found.scale_std,
    }
    result = replace(given, turntable=found.axis, residuals=replace(given.residuals, turntable=facts))
    result.save(out)
    content: dict[str, Any] = {"out": str(out), "turntable": found.axis.to_json(), **facts, "notes": _notes(found)}
    content |= {"shift_std_mm": found.axis.shift_std_mm, "tilt_std_deg": found.axis.tilt_std_deg}
    console.report(content, as_json=json, text=f"{_words(found)}\nwritten to {out}")


def _words(found: "FoundAxis") -> str:
    axis = found.axis
    point = ", ".join(f"{1e3 * value:.3f}" for value in axis.point)
    direction = ", ".join(f"{value:.6f}" for value in axis.direction)
    lines = [
        f"axis                through {point} mm, ± {axis.shift_std_mm:.3f} mm across it",
        f"  direction         {direction}, ± {axis.tilt_std_deg:.4f} deg",
        f"residual            {found.rms_px:.3f} px rms over {found.corners} corners in {len(found.view_rms_px)} views",
    ]
    return "\n".join([*lines, *(f"note: {note}" for note in _notes(found))])


def _notes(found: "FoundAxis") -> list[str]:
    """What a user should know, one sentence each."""
    off = found.scale - 1
    if abs(off) < SURE * found.scale_std or abs(off) < 1e-4:
        return []
    remedy = "correct turntable.units_per_turn and record again"
    return [f"the table turns by {100 * off:+.3f} ± {100 * found.scale_std:.3f} % more than it reports: {remedy}"]
