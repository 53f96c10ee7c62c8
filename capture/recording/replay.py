"""Repeats the joint path of a recording and measures how far each pose is from the recorded one."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import CaptureError, PlanningError
from koala3d.capture.drivers.protocols import Robot
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.rig import RigDescription, recorded_carrier
from koala3d.capture.model.trajectory import recorded_trajectory
from koala3d.capture.planning import Obstacles, connect
from koala3d.capture.rig.moves import Moves
from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import TRUTH, Recording

Joints = NDArray[np.float64]

SAME = 1e-6  # mounts that differ by less are the same [m and rad]
MEASURED_M = 1e-3
"""A recorded pose may be closer to something by this much: its joint angles were measured, and may miss the planned ones [m]."""


@dataclass(frozen=True)
class Deviation:
    """Deviation of the arm from the recorded state of one frame."""

    frame: str
    joints_deg: float  # largest difference of the measured joint angles
    translation_mm: float  # of the flange position that the controller reports
    rotation_deg: float  # of the flange orientation that the controller reports
    true_mm: float | None = None  # of the true flange position, in a simulation; what encoders do not see included

    @property
    def line(self) -> str:
        """The deviation in one line of text."""
        true = "" if self.true_mm is None else f", truly {self.true_mm:.3f} mm"
        return f"{self.translation_mm:.3f} mm, {self.rotation_deg:.4f} degrees, joints {self.joints_deg:.4f} degrees{true}"


def obstacles_around(recording: Recording, rig: RigDescription) -> Obstacles:
    """What is in the way if a rig repeats a recording: what stands around it now, with the recorded object and clearance.

    Raises UsageError: the recording was made with another model of arm, or with another mount.
    """
    was, remedy = recorded_carrier(recording), "replay it on the rig that made it (--rig)"
    carriers = [one.carrier() for one in rig.each.values()]
    if (arm := carriers[0].arm.name) != was.arm.name:
        why = f"with a {was.arm.name}, and this rig has a {arm}"
        raise UsageError("was recorded with another arm", where=recording.path, why=why, remedy=remedy)
    found = next((carrier for carrier in carriers if not _remounted(was, carrier)), None)
    if found is None:
        why = _remounted(was, carriers[0])
        raise UsageError("was recorded with another mount", where=recording.path, why=why, remedy=remedy)
    return Obstacles.of(recorded_trajectory(recording), found)


def _remounted(was: Carrier, now: Carrier) -> str:
    """How the mount differs, in words; empty: it does not."""
    places = ["on the flange" if carrier.beside is None else "beside the arm" for carrier in (was, now)]
    if places[0] != places[1]:
        return f"its camera was {places[0]}, and is {places[1]}"
    distance, angle = pose.difference(was.flange_from_carried, now.flange_from_carried)
    same = distance < SAME and angle < SAME
    return (
        ""
        if same
        else f"what the flange carries is {1e3 * distance:.1f} mm and {np.degrees(angle):.1f} degrees from where it was"
    )


def _paths(recording: Recording, start: Joints, obstacles: Obstacles) -> list[list[Joints]]:
    """The joint angles to pass through on the way to each frame, the last being those of the frame."""
    if not recording.frames:
        raise CaptureError("the recording has no frames", where=recording.path, remedy="record something first")
    for frame in recording.frames:
        pair, room = obstacles.nearest(frame.joints)
        if room < -MEASURED_M:
            why = f"{pair}, {1e3 * room:.0f} mm beyond the clearance"
            remedy = "remove what is in the way, or correct 'obstacles' in the rig file"
            raise PlanningError("a recorded pose is too close to something", where=f"view {frame.name}", why=why, remedy=remedy)
    stops = [start, *(frame.joints for frame in recording.frames)]
    names = [frame.name for frame in recording.frames]
    return [connect(*ends, obstacles, where=f"view {name}") for name, ends in zip(names, pairwise(stops), strict=True)]


def replay(
    recording: Recording,
    robot: Robot,
    obstacles: Obstacles,
    *,
    truth: Callable[[], Any] | None = None,
    moves: Moves | None = None,
    advance: Callable[[Deviation], None] = lambda one: None,
) -> list[Deviation]:
    """Move to the recorded joint angles of every frame, in recorded order, on collision-free paths.

    Args:
        recording: its trajectory defines speed and settling.
        obstacles: of the rig that repeats it, see `obstacles_around`.
        truth: simulation only: returns the true flange pose, (4, 4) [m].
        moves: how the arm moves; None: with the recorded speeds.

    Raises PlanningError: something is in the way, nothing has moved; CaptureError: the recording has no frames, or the arm failed
    and stands still.
    """
    paths = _paths(recording, robot.state().joints, obstacles)
    true_poses = _true_poses(recording) if truth is not None else {}
    motion, deviations, moves = recorded_trajectory(recording).motion, [], moves or Moves()
    for frame, path in zip(recording.frames, paths, strict=True):
        moves.along(robot, path, motion, obstacles, view=f"view {frame.name}")
        state = robot.state()
        distance, angle = pose.difference(state.base_from_flange, frame.base_from_flange)
        true_mm = None
        if truth is not None and frame.name in true_poses:
            true_mm = 1e3 * float(pose.difference(truth(), true_poses[frame.name])[0])
        turned = float(np.degrees(np.abs(state.joints - frame.joints).max()))
        deviations.append(Deviation(frame.name, turned, 1e3 * float(distance), float(np.degrees(angle)), true_mm))
        advance(deviations[-1])
    return deviations


def _true_poses(recording: Recording) -> dict[str, Any]:
    """True (4, 4) `base_from_flange` by name; empty for a recording of a real rig."""
    path: Path = recording.path / TRUTH / "poses.json"
    if not path.exists():
        return {}
    content = files.read_json(path)
    if content["flange_from_camera"] is None:  # the camera stands beside the arm
        return {name: np.asarray(matrix) for name, matrix in content["base_from_flange"].items()}
    camera_from_flange = pose.inverse(content["flange_from_camera"])
    return {name: np.asarray(matrix) @ camera_from_flange for name, matrix in content["base_from_camera"].items()}


def summary(deviations: list[Deviation]) -> dict[str, Any]:
    """Worst and root mean square deviation over all frames; `worst` as text."""

    def over(values: list[float]) -> dict[str, float]:
        return {"worst": max(values), "rms": float(np.sqrt(np.mean(np.square(values))))}

    found = {name: over([getattr(one, name) for one in deviations]) for name in ("joints_deg", "translation_mm", "rotation_deg")}
    true = [one.true_mm for one in deviations if one.true_mm is not None]
    words = f"{found['translation_mm']['worst']:.3f} mm, {found['rotation_deg']['worst']:.4f} degrees"
    if true:
        found["true_mm"] = over(true)
        words += f", truly {found['true_mm']['worst']:.3f} mm"
    return {**found, "worst": words}
