"""How far the views of a recording, or the planned ones of a trajectory, cover a shape that is known."""

from pathlib import Path

import numpy as np

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.rig import recorded_carrier
from koala3d.capture.model.trajectory import Trajectory, recorded_trajectory
from koala3d.capture.planning import PlannedView
from koala3d.capture.sessions.adaptive.known_shape import covered_after, surface_of
from koala3d.capture.sessions.adaptive.session import check
from koala3d.capture.sessions.adaptive.shape import eye_of, lens_of
from koala3d.datasets.building.build import camera_for
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import Recording

STEP = 10  # the text has a line for every so many views


def of_recording(path: Path, mesh: Path, scale: float, calibration: Calibration | None) -> list[float]:
    """Share of a mesh that is covered after each training view of a recording, in the order in which they were taken."""
    recording = Recording.open(path)
    session = recorded_trajectory(recording)
    check(session)
    frames = sorted((one for one in recording.frames if one.split == "train"), key=lambda one: one.host_time_ns)
    if not frames:
        raise UsageError("has no training views", where=path, remedy="continue it with --resume")
    eye = eye_of(recorded_carrier(recording).flange_from_camera, calibration)
    cameras = np.stack([eye(frame.base_from_flange, frame.joints) for frame in frames])
    camera = None if calibration is None else camera_for(recording, calibration)[0]
    return covered_after(surface_of(mesh, session, scale), cameras, camera)


def of_plan(
    session: Trajectory, mount: Carrier, planned: list[PlannedView], mesh: Path, scale: float, calibration: Calibration | None
) -> list[float]:
    """Share of a mesh that is covered after each planned training view."""
    check(session)
    eye = eye_of(mount.flange_from_camera, calibration)
    views = [view.joints for view in planned if view.viewpoint.split == "train"]
    cameras = np.stack([eye(mount.forward(joints), joints) for joints in views])
    return covered_after(surface_of(mesh, session, scale), cameras, lens_of(session, calibration))


def lines(shares: list[float]) -> list[str]:
    """The shares for a person, after every `STEP` views and after the last."""
    counts = sorted({*range(STEP, len(shares), STEP), len(shares)})
    return [f"{count:4d} views: {100 * shares[count - 1]:5.1f} % of the surface covered" for count in counts]
