"""Frames of a video that are worth reconstructing from: sharp ones, evenly spaced by how far the picture has moved.

One pass looks at every frame in a small version, a second writes the chosen ones. Movement is what optical flow (Lucas and Kanade
1981) sees between neighbours, so a camera that rests adds no frames, and one that hurries is not left with gaps.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.core.files import atomic_folder
from koala3d.datasets.core.progress import Count, ignore
from koala3d.datasets.imaging import images
from koala3d.datasets.process.pictures import videos

SIDE = 480
"""Longest side of the frames that are compared [px]."""
SHORTEST = 0.01
"""Least movement between two chosen frames, as a share of the picture's diagonal: less has no parallax to speak of."""
CORNERS = 200
"""Places that are followed from one frame to the next."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What is known of every frame of a video."""

    sharpness: NDArray[np.float64]
    """(n,) variance of the Laplacian."""
    moved: NDArray[np.float64]
    """(n,) sum of the movements up to each frame, in picture diagonals; of one between two frames, the median place's."""


def extract(video: Path, count: int, folder: Path, *, done: Count = ignore) -> list[str]:
    """Write the best `count` frames of a video as JPEG files to a new folder, all or nothing; fewer where it moves too little.

    Returns:
        Names of the files: the number of the frame in the video. `done` is called with the frames handled and to handle.

    Raises:
        UsageError: it is no video, or nothing moves in it.
    """
    shown = videos.length(video)
    motion = observe(video, done=lambda k: done(k, max(2 * shown, k)))
    total = len(motion.moved)
    wanted = {int(index) for index in choose(motion, count)}
    if len(wanted) < 3:
        why = f"{total} frames, in which the picture moves by {100 * motion.moved[-1]:.0f}% of its diagonal"
        raise UsageError("video shows too little movement", where=video, why=why, remedy="walk around the object")
    names = []
    with atomic_folder(folder) as temporary:
        for index, frame in enumerate(videos.decoded(video)):
            if index in wanted:
                names.append(f"frame_{index:06d}.jpg")
                images.write(temporary / names[-1], videos.picture(frame))
            done(total + index + 1, 2 * total)
            if len(names) == len(wanted):
                break
    return names


def observe(video: Path, *, done: Any = ignore) -> Motion:
    """Sharpness and movement of all frames. `done` is called with the number of frames seen."""
    import cv2

    sharpness, moved, before = [], [0.0], None
    for index, frame in enumerate(videos.decoded(video)):
        shrink = max(frame.width, frame.height) / SIDE
        size = {} if shrink <= 1 else {"width": round(frame.width / shrink), "height": round(frame.height / shrink)}
        grey = np.ascontiguousarray(frame.reformat(format="gray", **size).to_ndarray())
        sharpness.append(float(cv2.Laplacian(grey, cv2.CV_32F).var()))
        if before is not None:
            moved.append(moved[-1] + movement(before, grey))
        before = grey
        done(index + 1)
    if not sharpness:
        raise DatasetError("video holds no frames", where=video, remedy="copy it again")
    return Motion(np.array(sharpness), np.array(moved))


def movement(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> float:
    """How far the median place moves between two grey pictures, as a share of the diagonal; 0 where nothing can be followed."""
    import cv2

    places = cv2.goodFeaturesToTrack(before, CORNERS, 0.01, 5)
    if places is None:
        return 0.0
    found, good, _ = cv2.calcOpticalFlowPyrLK(before, after, places, np.zeros_like(places))
    shifts = np.linalg.norm((found - places).reshape(-1, 2), axis=1)[good.ravel() == 1]
    return float(np.median(shifts)) / float(np.hypot(*before.shape)) if len(shifts) else 0.0


def choose(motion: Motion, count: int) -> NDArray[np.int64]:
    """Indices of at most `count` frames: the sharpest of each of as many windows of equal movement.

    Windows are no shorter than `SHORTEST`. Of each, only the middle half is used, so that neighbours keep their distance; where a
    camera hurries and leaves that empty, the frames that are nearest to the middle.
    """
    total = float(motion.moved[-1])
    windows = int(min(count, max(total // SHORTEST, 1)))
    place = motion.moved / max(total, 1e-12) * windows
    chosen = []
    for window in range(windows):
        away = np.abs(place - (window + 0.5))
        inside = np.flatnonzero(away <= max(0.25, away.min() + 0.1))
        chosen.append(int(inside[motion.sharpness[inside].argmax()]))
    return np.unique(chosen)
