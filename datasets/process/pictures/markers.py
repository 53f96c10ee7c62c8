"""Printed square markers (ArUco, AprilTag, those of ChArUco boards) in pictures; dictionaries are tried by themselves.

What one picture shows is a guess. A marker counts when its corners, triangulated from several pictures, form a square.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import conventions
from koala3d.datasets.scene import View
from koala3d.datasets.structure.triangulate import meeting_point

DICTIONARIES = (
    "4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL", "ARUCO_MIP_36h12",
    "APRILTAG_16h5", "APRILTAG_25h9", "APRILTAG_36h10", "APRILTAG_36h11",
)  # fmt: skip
"""OpenCV's dictionaries; those of fewer markers are the beginnings of these."""
FEWEST = 3
"""Smallest number of pictures that a marker must be seen in."""
SQUARE = 0.04
"""Largest relative difference of the sides, and of the diagonals from sqrt(2) sides, of what counts as a square."""
ERROR_PX = 3.0
"""Largest distance of a triangulated corner from where a picture shows it [px of a picture of 1000 pixels]."""


@dataclass(frozen=True, eq=False)
class Marker:
    """A marker in one picture."""

    kind: str
    """Dictionary and number, such as "5X5_1000 7"."""
    corners: NDArray[np.float64]
    """(4, 2) pixels, clockwise from the upper left corner of the print."""


@dataclass(frozen=True, eq=False)
class PlacedMarker:
    """A marker in the world."""

    kind: str
    corners: NDArray[np.float64]
    """(4, 3) in the order of `Marker`."""
    seen: int
    """Number of pictures that agree."""

    @property
    def side(self) -> float:
        """Mean side of the square [world unit]."""
        return float(_sides(self.corners).mean())

    @property
    def normal(self) -> NDArray[np.float64]:
        """(3,) unit vector out of the print, towards those who see it."""
        across = np.cross(self.corners[2] - self.corners[0], self.corners[3] - self.corners[1])
        return -across / np.linalg.norm(across)


def detect(grey: NDArray[np.uint8]) -> list[Marker]:
    """Markers in a picture of bytes."""
    corners, numbers, _, which = _detector().detectMarkersMultiDict(grey)
    if numbers is None:
        return []
    found = zip(corners, np.ravel(numbers), np.ravel(which), strict=True)
    return [Marker(f"{DICTIONARIES[k]} {n}", conventions.pixels_from_opencv(c.reshape(4, 2))) for c, n, k in found]


@cache
def _detector() -> Any:
    import cv2

    dictionaries = [cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}")) for name in DICTIONARIES]
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(dictionaries, settings)


def place(views: Sequence[View], seen: Mapping[str, Sequence[Marker]]) -> list[PlacedMarker]:
    """The markers that several views agree on, the one seen by most first. `seen` holds each view's markers by its name."""
    sightings = defaultdict(list)
    for view in views:
        kinds = [marker.kind for marker in seen.get(view.name, ())]
        for marker in seen.get(view.name, ()):
            if kinds.count(marker.kind) == 1:
                sightings[marker.kind].append((view, marker.corners))
    placed = [_placed(kind, pairs) for kind, pairs in sightings.items() if len(pairs) >= FEWEST]
    return sorted((marker for marker in placed if marker is not None), key=lambda marker: -marker.seen)


def _placed(kind: str, pairs: list[tuple[View, NDArray[np.float64]]]) -> PlacedMarker | None:
    """A marker from the views that saw it; None where they do not agree on a square."""
    while len(pairs) >= FEWEST:
        places = [meeting_point([(view, pixels[corner]) for view, pixels in pairs]) for corner in range(4)]
        if any(place is None for place in places):
            return None
        corners = np.stack([place for place in places if place is not None])
        errors = [_error(view, corners, pixels) for view, pixels in pairs]
        if max(errors) <= ERROR_PX:
            return PlacedMarker(kind, corners, len(pairs)) if _is_square(corners) else None
        del pairs[int(np.argmax(errors))]
    return None


def _error(view: View, corners: NDArray[np.float64], pixels: NDArray[np.float64]) -> float:
    local = (corners - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    if (local[:, 2] <= 0).any():
        return np.inf
    size = max(view.camera.width, view.camera.height)
    return float(np.linalg.norm(view.camera.project(local) - pixels, axis=1).max()) * 1000 / size


def _sides(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)


def _is_square(corners: NDArray[np.float64]) -> bool:
    sides = _sides(corners)
    diagonals = np.linalg.norm(corners[:2] - corners[2:], axis=1) / np.sqrt(2)
    lengths = np.concatenate([sides, diagonals])
    return bool(np.ptp(lengths) <= SQUARE * lengths.mean())
