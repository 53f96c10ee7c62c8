"""Repeats the joint path of a recording and measures how far each pose is from the recorded one."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.drivers.protocols import Robot
from koala3d.capture.model.rig import recorded_carrier
from koala3d.capture.model.trajectory import recorded_trajectory
from koala3d.capture.planning import Obstacles, connect
from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.recording import TRUTH, Recording


@dataclass(frozen=True)
class Deviation:
    """Deviation of the arm from the recorded state of one frame."""

    frame: str
    joints_deg: float  # largest difference of the measured joint angles
    translation_mm: float  # of the flange position that the controller reports
    rotation_deg: float  # of the flange orientation that the controller reports
    true_mm: float | None = None  # of the true flange position, in a simulation; only this shows the repeatability of the arm

    @property
    def line(self) -> str:
        """The deviation in one line of text."""
        true = "" if self.true_mm is None else f", truly {self.true_mm:.3f} mm"
        return f"{self.translation_mm:.3f} mm, {self.rotation_deg:.4f} degrees, joints {self.joints_deg:.4f} degrees{true}"


def replay(
    recording: Recording,
    robot: Robot,
    *,
    truth: Callable[[], Any] | None = None,
    advance: Callable[[Deviation], None] = lambda one: None,
) -> list[Deviation]:
    """Move to the recorded joint angles of every frame, in recorded order, on collision-free paths.

    Args:
        recording: of any rig. Its trajectory defines speed, settling and obstacles.
        truth: simulation only: returns the true flange pose, (4, 4) [m].

    Raises CaptureError: the recording has no frames, or the arm failed and stands still.
    """
    if not recording.frames:
        raise CaptureError("the recording has no frames", where=recording.path, remedy="record something first")
    trajectory = recorded_trajectory(recording)
    obstacles = Obstacles.of(trajectory, recorded_carrier(recording))
    true_poses = _true_poses(recording) if truth is not None else {}
    motion, deviations = trajectory.motion, []
    for frame in recording.frames:
        for joints in connect(robot.state().joints, frame.joints, obstacles, where=f"view {frame.name}"):
            robot.move_to(joints, speed=motion.speed, acceleration=motion.acceleration)
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
