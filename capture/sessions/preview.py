"""The page that a person can look at before a session that chooses its views moves the arm for the first time."""

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.planning import preview
from koala3d.capture.recording.growing import GrowingRecording
from koala3d.datasets.core import console


def show_reach(recording: GrowingRecording, joints: NDArray[np.float64]) -> None:
    """Write the page beside the recording and name it: (m, n) configurations of the views that may be chosen [rad]."""
    if not len(joints):
        return
    path = recording.out.with_name(f"{recording.out.name}.preview.html")
    title = f"{recording.trajectory.name}: {len(joints)} views to choose from"
    preview.write(recording.joints(), joints, recording.obstacles, path, title=title)
    console.hint(f"{path} shows where the arm may go")
