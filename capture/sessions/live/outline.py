"""The object's box over the live picture: its edges and its middle, as the calibrated camera sees them from where the arm is."""

from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.trajectory import Trajectory
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging.region import Region

Array = NDArray[np.float64]

ALONG = 24
"""Pieces of an edge: a lens bends it."""
NEAREST_M = 1e-3  # what is nearer to the camera's plane, or behind it, is not drawn
COLOUR = (255, 210, 40)  # sRGB
CROSS = 0.03  # half the length of the cross's arms, in widths of the picture


@dataclass(frozen=True)
class Outline:
    """A box in the base, and the calibration through which it is seen."""

    corners: Array
    """(2, 3): low and high [m]."""
    calibration: Calibration
    camera: Camera
    """Of the pictures."""

    @classmethod
    def of(cls, trajectory: Trajectory, calibration: Calibration, said: dict[str, Any]) -> Self:
        """The box of a trajectory's object.

        Args:
            said: the camera's own description, whose region the pictures show.

        Raises:
            UsageError: there is no box, or the calibration is for another size of pictures.
            DatasetError: it has no hand-eye pose.
        """
        if trajectory.object is None:
            remedy = "give it 'object', or leave --calibration out"
            raise UsageError("the trajectory has no object", where=trajectory.name, remedy=remedy)
        calibration.camera_pose(np.eye(4), np.zeros(0))  # has one
        camera, region = calibration.camera, calibration.region
        if said.get("region") is not None and region is not None:
            camera = region.converted(camera, Region.from_json(said["region"], where="camera"))
        width, height = trajectory.camera.width, trajectory.camera.height
        if (camera.width, camera.height) != (width, height):
            why = f"pictures are {width}x{height}, the calibrated camera is {camera.width}x{camera.height}"
            remedy = "calibrate with the same region of interest and binning"
            raise UsageError("calibration is for another image size", where="--calibration", why=why, remedy=remedy)
        return cls(np.asarray(trajectory.object.corners, np.float64), calibration, camera)

    def edges(self, base_from_camera: Array) -> list[Array]:
        """(k, 2) pixels along the parts of the twelve edges that lie before the camera."""
        signs = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T
        pairs = [(a, b) for a in signs for b in signs if (b - a).min() == 0 and (b - a).sum() == 1]
        share = np.linspace(0, 1, ALONG + 1)[:, None]
        found = []
        for a, b in pairs:
            points = self._corner(a) * (1 - share) + self._corner(b) * share
            inside = _seen(points, base_from_camera)
            ahead = inside[:, 2] > NEAREST_M
            found += [self.camera.project(run) for run in _runs(inside, ahead)]
        return found

    def middle(self, base_from_camera: Array) -> Array | None:
        """(2,) pixel of the box's middle; None where it is behind the camera."""
        inside = _seen(self.corners.mean(0), base_from_camera)
        return self.camera.project(inside) if inside[2] > NEAREST_M else None

    def drawn(self, picture: NDArray[np.uint8], base_from_flange: Array, joints: Array) -> NDArray[np.uint8]:
        """A picture (h, w, 3) of any size with the box and a cross in its middle."""
        base_from_camera = self.calibration.camera_pose(base_from_flange, joints)
        scale, marked = picture.shape[1] / self.camera.width, np.ascontiguousarray(picture)
        for edge in self.edges(base_from_camera):
            cv2.polylines(marked, [_fixed(scale * edge)], False, COLOUR, 1, cv2.LINE_AA, shift=4)
        middle = self.middle(base_from_camera)
        if middle is not None and np.abs(scale * middle).max() < 4 * max(picture.shape):
            arm = CROSS * picture.shape[1]
            for along in ((arm, 0), (0, arm)):
                ends = np.stack([scale * middle - along, scale * middle + along])
                cv2.polylines(marked, [_fixed(ends)], False, COLOUR, 1, cv2.LINE_AA, shift=4)
        return marked

    def _corner(self, which: NDArray[np.int64]) -> Array:
        return self.corners[which, np.arange(3)]


def _seen(points: Array, base_from_camera: Array) -> Array:
    """(..., 3) points of the base in the camera's axes."""
    return (points - base_from_camera[:3, 3]) @ base_from_camera[:3, :3]


def _runs(points: Array, kept: NDArray[np.bool_]) -> list[Array]:
    """The parts of a line, two points or longer, that are kept."""
    parts = np.split(np.arange(len(points)), np.flatnonzero(np.diff(kept)) + 1)
    return [points[part] for part in parts if kept[part[0]] and len(part) > 1]


def _fixed(pixels: Array) -> NDArray[np.int32]:
    """Pixels as OpenCV draws them: its first centre is (0, 0), in sixteenths, kept within what an integer holds."""
    return np.clip(16 * (pixels - 0.5), -(2**24), 2**24).round().astype(np.int32)
