"""What every writer is given: a calibration, and the names that other programs have for its frames.

Frames are named as ROS's driver of Universal Robots names them. `tool0` and `base` are those of the arm's controller, flange and
base; ROS's `base_link` is turned by half a turn about z against `base`. Camera frames follow REP 103: `camera_optical_frame` is
Koala's (x right, y down, z forward), `camera_link` the body frame with the same origin (x forward, y left, z up).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import UsageError

FRAMES = {"flange": "tool0", "base": "base", "camera": "camera_optical_frame", "board": "board"}
"""Koala's frames in the words of ROS."""
BODY = "camera_link"
BODY_FROM_OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""(4, 4) from the camera's axes x right, y down, z forward to x forward, y left, z up."""


@dataclass(frozen=True)
class Source:
    """A calibration that is exported."""

    calibration: Calibration
    path: Path
    name: str
    """Of the new file, without its suffix."""
    recording: Path | None = None
    """Folder that it was made from, if that was moved."""

    @property
    def on_flange(self) -> bool:
        """True for a camera on the flange, false for one that stands beside the arm."""
        return self.calibration.flange_from_camera is not None

    def pose(self, wanted: str = "camera") -> tuple[str, Array]:
        """The frame of ROS that carries the camera, and the (4, 4) transform to it from the camera [m].

        Raises UsageError: the calibration is of the camera alone.
        """
        for carrier in ("flange", "base"):
            found = self.calibration.poses.get(f"{carrier}_from_{wanted}")
            if found is not None:
                return FRAMES[carrier], found.matrix
        why, remedy = "it is of the camera alone", "make one with 'calib handeye'"
        raise UsageError("calibration holds no hand-eye pose", where=self.path, why=why, remedy=remedy)

    def notes(self) -> list[str]:
        """What whoever reads the file has to know, one sentence each."""
        found = [f"Written by Koala from {self.path.name}. Lengths are metres, angles radians."]
        if self.calibration.link_errors is not None:
            words = "The pose of the camera was estimated together with errors of the arm's links, which this file cannot hold"
            found.append(f"{words}: with poses of the uncorrected arm it is less accurate.")
        return found

    def frame_notes(self) -> list[str]:
        """Which way the camera's pose goes, and between which frames."""
        parent, _ = self.pose()
        base = "its flange" if self.on_flange else "its base; not ROS's base_link, which is turned by half a turn about z"
        return [
            f"The pose takes coordinates in {FRAMES['camera']} (x right, y down, z forward) to {parent}.",
            f"{parent} is the frame of the arm's controller for {base}.",
        ]


def text(*numbers: float) -> str:
    """Numbers with all their digits, a space between."""
    return " ".join(repr(float(one) + 0.0) for one in numbers)
