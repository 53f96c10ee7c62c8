"""One session of `capture repeatability`: visits, the poses that the pictures show, and what they say."""

import json
import subprocess
import sys
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.model.rig import recorded_carrier
from koala3d.capture.model.trajectory import Trajectory, recorded_trajectory
from koala3d.capture.recording.recorder import record
from koala3d.capture.sessions.repeatability.plot import drawn
from koala3d.capture.sessions.repeatability.spread import AXES, Repeatability, SeenVisit, repeatability
from koala3d.capture.sessions.repeatability.visits import PICTURES, planned_visits, visits_to
from koala3d.capture.sessions.start import SessionOptions
from koala3d.datasets import pose
from koala3d.datasets.core import console, files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import Frame, Recording

FORMAT, VERSION = "koala-repeatability", 1
Array = NDArray[np.float64]
JSON, PICTURE = "repeatability.json", "repeatability.png"
"""In the recording's folder."""


def run(
    trajectory: Trajectory, out: Path, options: SessionOptions, visits: int, views: int, calibration: Path | None
) -> Repeatability:
    """Take the pictures that are missing in `out`, and write what they say beside them.

    Args:
        calibration: file with the camera; None: it is estimated from the pictures.

    Raises UsageError: the rig has several cameras, or `out` holds another session. CaptureError: an error of the rig; the arm
    stands still, and `out` can be resumed. DatasetError: too few visits show the target.
    """
    from koala3d.capture.rig.naming import describe, scene_for

    description = describe(options.rig)
    if description.cameras:
        remedy = "use a rig file of one of them"
        raise UsageError(
            "repeatability is measured with one camera", why=f"the rig has {len(description.cameras)}", remedy=remedy
        )
    session = visits_to(trajectory, description.carrier(), visits, views)
    options = replace(options, scene=scene_for(options.rig, options.scene, trajectory))
    with console.progress("capture", session.number, "pictures") as shown, options.opened(session, out) as rig:
        planned = planned_visits(session, rig.carrier)
        record(session, rig, out, resume=options.resume, planned=planned, advance=lambda name: shown.advance())
    found = measured(out, calibration)
    files.write_json(out / JSON, {"format": FORMAT, "version": VERSION, **found.to_json()})
    with files.atomic_path(out / PICTURE) as temporary:
        drawn(found).savefig(temporary, dpi=120)
    return found


def measured(path: Path, calibration: Path | None) -> Repeatability:
    """What the pictures of a recording say. Raises as `repeatability` does; CaptureError: the target is not found."""
    return repeatability(seen_visits(Recording.open(path), _views(path, calibration)))


def seen_visits(recording: Recording, views: dict[str, dict[str, Any]]) -> list[SeenVisit]:
    """What each visit shows, by what `calib poses` says of each view; views that it leaves out are left out.

    Raises UsageError: it is another kind of recording.
    """
    carrier, places = recorded_carrier(recording), _places(recording)
    stops: dict[tuple[int, int], list[Frame]] = {}
    for frame in sorted(recording.frames, key=lambda one: one.index):
        if frame.name in views:
            stops.setdefault((frame.index % places // PICTURES, frame.index // places), []).append(frame)
    first: dict[int, Frame] = {}
    return [
        _visit(view, visit, frames, carrier.camera_at(first.setdefault(view, frames[0]).base_from_flange), views)
        for (view, visit), frames in stops.items()
    ]


def _visit(view: int, visit: int, frames: list[Frame], base_from_camera: Array, views: dict[str, dict[str, Any]]) -> SeenVisit:
    """The mean of the pictures of one visit, with the camera taken to be at one place.

    That place follows from the nominal mount: if its axes are off by a few degrees, so are those of the result.
    """
    shown = [views[frame.name] for frame in frames]
    placed = [base_from_camera @ np.asarray(one["middle"], np.float64) for one in shown]
    turns = np.mean([pose.rotation_vector(one[:3, :3] @ placed[0][:3, :3].T) for one in placed], axis=0)
    middle = pose.rigid(
        pose.from_rotation_vector(turns)[:3, :3] @ placed[0][:3, :3], np.mean([one[:3, 3] for one in placed], axis=0)
    )
    axes = np.kron(np.eye(2), placed[0][:3, :3])
    covariance = axes @ np.asarray(shown[0]["covariance"], np.float64) @ axes.T
    corners = set.intersection(*(set(one["residuals"]) for one in shown))
    residuals = {corner: np.mean([one["residuals"][corner] for one in shown], axis=0) for corner in corners}
    warm = [float(np.mean(frame.joint_temperatures)) for frame in frames if frame.joint_temperatures]
    temperature = float(np.mean(warm)) if len(warm) == len(frames) else None
    return SeenVisit(view, visit, float(np.mean([_time_s(one) for one in frames])), temperature, middle, covariance, residuals)


def _places(recording: Recording) -> int:
    """Number of pictures of one round. Raises UsageError: the recording has no rounds."""
    views = recorded_trajectory(recording).viewpoints()
    joints = [tuple(view.joints) for view in views if view.joints is not None]
    rounds = joints.count(joints[0]) // PICTURES if joints else 0
    if rounds < 1 or len(joints) < len(views) or len(joints) % rounds:
        remedy = "resume it with the command that made it, or choose another --out"
        raise UsageError("is no session of 'capture repeatability'", where=recording.path, remedy=remedy)
    return len(joints) // rounds


def _time_s(frame: Frame) -> float:
    """The wall-clock time: the other clocks begin anew when computer or controller are started again."""
    return frame.host_time_ns * 1e-9 if frame.wall_time is None else datetime.fromisoformat(frame.wall_time).timestamp()


def _views(path: Path, calibration: Path | None) -> dict[str, dict[str, Any]]:
    """What each picture that shows the target says of it: the package `calib` looks, in a process of its own."""
    given = [] if calibration is None else ["--intrinsics", str(calibration)]
    command = [sys.executable, "-m", "koala3d.calib.cli", "poses", str(path), *given]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        why = (done.stderr.strip().splitlines() or ["it printed nothing"])[-1].removeprefix("error: ")
        raise CaptureError("the target cannot be found in the pictures", where=path, why=why, remedy="the pictures are kept")
    found: dict[str, dict[str, Any]] = json.loads(done.stdout)["views"]
    return found


def describe(out: Path, found: Repeatability) -> str:
    """The figures in a few lines."""
    visits, views = len(np.unique(found.visits)), len(np.unique(found.views))
    lines = [
        f"{out}: {visits} visits to {views} views in {found.minutes:.1f} min",
        "where the target is seen, along the axes of the base, with 95 % limits:",
        _row("", ["x", "y", "z"], ["about x", "about y", "about z"]),
        _row("spread of a visit, standard deviation", *_pairs(found.spread, found.spread_error)),
        _row("corners seen off, not included", *_pairs(found.seeing, None)),
        _row("drift from first to last visit", *_pairs(found.drift, found.drift_error)),
    ]
    if found.warming is None:
        lines.append("the controller does not report the temperatures of the joints")
    else:
        lines.append(f"the joints became warmer by {found.warming:.1f} degrees")
    if found.per_degree is not None:
        lines.append(_row("change per degree", *_pairs(found.per_degree, found.per_degree_error)))
    if (doubtful := [name for name, s, e in zip(AXES, found.spread, found.spread_error, strict=True) if s < 2 * e]) != []:
        lines.append(f"not above its uncertainty: {', '.join(doubtful)}; more --visits, a nearer target or larger pictures help")
    return "\n".join([*lines, f"written to {out / JSON} and {out / PICTURE}"])


def _row(title: str, millimetres: list[str], millidegrees: list[str]) -> str:
    return (
        f"  {title:38}"
        + "".join(f"{cell:>18}" for cell in millimetres)
        + " mm  " * bool(title)
        + "     " * (not title)
        + ("".join(f"{cell:>16}" for cell in millidegrees) + " mdeg" * bool(title))
    )


def _pairs(values: NDArray[np.float64], errors: NDArray[np.float64] | None) -> tuple[list[str], list[str]]:
    """Three cells in mm and three in mdeg."""
    limits = np.zeros(6) if errors is None else 2 * errors
    cells = [
        (f"{value:.4f}" if i < 3 else f"{value:.2f}")
        + ("" if errors is None else f" ± {limit:.4f}" if i < 3 else f" ± {limit:.2f}")
        for i, (value, limit) in enumerate(zip(values, limits, strict=True))
    ]
    return cells[:3], cells[3:]


def facts(out: Path, found: Repeatability) -> dict[str, Any]:
    """The figures for a program."""
    content = {name: value for name, value in found.to_json().items() if name != "stops"}
    return {"recording": str(out), "file": str(out / JSON), "picture": str(out / PICTURE), **content}
