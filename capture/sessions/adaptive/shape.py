"""What the pictures so far show of the object: its shape before the table, and where its colour changes with direction.

Without a calibration nothing can be told from pictures: the object's stated box stands for its shape.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.sessions.adaptive.background import outlines, table_height
from koala3d.capture.sessions.adaptive.candidates import seen_from
from koala3d.capture.sessions.adaptive.carving import carved
from koala3d.capture.sessions.adaptive.gain import Seen
from koala3d.capture.sessions.adaptive.loop import Known
from koala3d.capture.sessions.adaptive.places import Places, of_box
from koala3d.capture.sessions.adaptive.sight import Eye
from koala3d.datasets.building.build import camera_for
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import MANIFEST, Frame, Recording
from koala3d.datasets.scene import View

Array = NDArray[np.float64]

FEWEST_VIEWS = 8
"""Views that masks and colours need."""
GROWTH = 1.15
"""The shape is found again when there are so many times more views."""
SIDE = 480
"""Longest side of the pictures in which colours are compared [px]."""
UNKNOWN = 0.5
"""How much colours are taken to change with direction where the pictures do not say it."""
BOX = "the object's box"
SAME, DIFFERENT = 0.03, 0.15
"""Standard deviation of a place's sRGB over the views up to which its colour is the same, and from which it changes fully."""


def eye_of(flange_from_camera: Array, calibration: Calibration | None) -> Eye:
    """Where the camera is when the flange is somewhere: by the calibration, else by the mount of the rig file."""
    if calibration is None:
        return lambda base_from_flange, joints: base_from_flange @ flange_from_camera
    if calibration.flange_from_camera is None:
        remedy = "make one with 'capture calibrate' or 'calib handeye'"
        raise UsageError("calibration holds no hand-eye pose", where="--calibration", remedy=remedy)
    return calibration.camera_pose


def lens_of(trajectory: Trajectory, calibration: Calibration | None) -> Camera | None:
    """The calibrated camera for pictures of a trajectory that is not recorded yet; None without a calibration.

    Where the trajectory states no offsets, its region is taken to be centred where that of the calibration is.

    Raises UsageError: the calibration is for pictures of another size, and does not know which region of the sensor they show.
    """
    if calibration is None:
        return None
    camera, region, wanted = calibration.camera, calibration.region, trajectory.camera
    if region is not None:
        shown = region.middle(wanted.width, wanted.height, wanted.binning)
        given = {"offset_x": wanted.offset_x, "offset_y": wanted.offset_y}
        return region.converted(camera, replace(shown, **{name: value for name, value in given.items() if value is not None}))
    if (camera.width, camera.height) != (wanted.width, wanted.height):
        why = f"pictures are {wanted.width}x{wanted.height}, the calibrated camera is {camera.width}x{camera.height}"
        remedy = "calibrate with the same region of interest and binning, or leave --calibration out"
        raise UsageError("calibration is for another image size", where="--calibration", why=why, remedy=remedy)
    return camera


class Shape:
    """The shape of the object as the recording grows.

    Args:
        out: the recording.
        calibration: camera and mount; None: the box stands for the shape.

    Raises UsageError: the trajectory has no object.
    """

    def __init__(self, trajectory: Trajectory, out: Path, eye: Eye, calibration: Calibration | None) -> None:
        if trajectory.object is None:
            remedy = "state 'object' in the trajectory: where it stands, and how large it is at most"
            raise UsageError("views of what is not known to be somewhere cannot be chosen", where=trajectory.name, remedy=remedy)
        self.trajectory, self.out, self.eye, self.calibration = trajectory, Path(out), eye, calibration
        self.corners = trajectory.object.corners
        self._places, self._source, self._count = of_box(self.corners, trajectory.upwards), BOX, 0
        self._read: dict[str, NDArray[np.float32]] = {}
        self._table: float | None = None  # where the pictures find its top [m]

    def known(self) -> Known:
        """What the pictures on the disk show."""
        recording = Recording.open(self.out) if (self.out / MANIFEST).is_file() else None
        frames = [] if recording is None else recording.frames
        poses = np.array([self.eye(one.base_from_flange, one.joints) for one in frames]).reshape(-1, 4, 4)
        train = poses[[frame.split == "train" for frame in frames]]
        if recording is None or self.calibration is None or len(frames) < FEWEST_VIEWS or len(train) < 1:
            return Known(self._places, np.full(len(self._places.points), UNKNOWN), train, None, self._source)
        camera, _ = camera_for(recording, self.calibration)
        pictures, table = self._pictures(recording, frames, camera, poses), self.trajectory.safety.table_z
        if table is not None and len(frames) >= GROWTH * self._count:
            self._table = pictures.table_height(self.corners, table) if self._table is None else self._table
            self._count, found = len(frames), pictures.shape(self.corners, self._table)
            self._places = found or of_box(self.corners, self.trajectory.upwards)
            self._source = BOX if found is None else f"{len(frames)} pictures"
        return Known(self._places, pictures.changing(self._places), train, camera, self._source)

    def _pictures(self, recording: Recording, frames: list[Frame], camera: Camera, cameras: Array) -> "_Pictures":
        """The pictures of frames; each is read once."""
        views = [
            View(frame.name, camera, pose, frame.split, recording.image_path(frame))
            for frame, pose in zip(frames, cameras, strict=True)
        ]
        for view in views:
            if view.name not in self._read:
                self._read[view.name] = _read_small(view)
        return _Pictures(tuple(views), tuple(self._read[view.name] for view in views))


@dataclass(frozen=True, eq=False)
class _Pictures:
    """The views so far, with small pictures."""

    views: tuple[View, ...]
    small: tuple[NDArray[np.float32], ...]
    """For each view (height, width, 3) sRGB from 0 to 1."""

    @property
    def _cameras(self) -> tuple[list[Camera], Array]:
        """The cameras of the small pictures, and their (m, 4, 4) poses [m]."""
        cameras = [_small_camera(view.camera, picture) for view, picture in zip(self.views, self.small, strict=True)]
        return cameras, np.stack([view.world_from_camera for view in self.views])

    def table_height(self, corners: Array, table_z: float) -> float:
        """Where the pictures find the top of the table, near `table_z` [m]."""
        return table_height(self.small, *self._cameras, corners.mean(0)[:2], table_z)

    def shape(self, corners: Array, table_z: float) -> Places | None:
        """The surface of the object, see `carving.carved`."""
        return carved(outlines(self.small, *self._cameras, corners.mean(0)[:2], table_z), corners, table_z)

    def changing(self, places: Places) -> Array:
        """(n,) how much the colour of each place changes between the training views that see it well, from 0 to 1."""
        train = [(view, picture) for view, picture in zip(self.views, self.small, strict=True) if view.split == "train"]
        seen = seen_from(np.stack([view.world_from_camera for view, _ in train]), places, self.views[0].camera)
        found = [_colours(view, picture, places, well) for (view, picture), well in zip(train, seen.well, strict=True)]
        return colour_changes(np.stack(found), seen)


def colour_changes(colours: NDArray[np.float32], seen: Seen) -> Array:
    """(n,) how much each place's colour changes with direction, from 0 to 1; 0 where fewer than three views see it well.

    Args:
        colours: (views, n, 3) sRGB from 0 to 1; those that are not seen well do not count.
    """
    well, counts = seen.well[..., None], seen.counts[:, None]
    mean = (colours * well).sum(0) / np.maximum(counts, 1)
    variance = (np.square(colours - mean) * well).sum(0) / np.maximum(counts - 1, 1)
    deviation = np.sqrt(variance.mean(-1))
    return np.where(seen.counts >= 3, np.clip((deviation - SAME) / (DIFFERENT - SAME), 0, 1), 0.0)


def _small_camera(camera: Camera, picture: NDArray[Any]) -> Camera:
    return camera.scaled(picture.shape[1], picture.shape[0])


def _read_small(view: View) -> NDArray[np.float32]:
    scale = min(1.0, SIDE / max(view.camera.width, view.camera.height))
    width, height = max(round(scale * view.camera.width), 1), max(round(scale * view.camera.height), 1)
    return images.as_float(view.read_resized(width, height)[..., :3])


def _colours(view: View, picture: NDArray[np.float32], places: Places, well: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(n, 3) sRGB of the pixels that show the places which the view sees well; black for the others."""
    local = (places.points[well] - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    column, row = np.floor(_small_camera(view.camera, picture).project(local)).T.astype(int)
    height, width = picture.shape[:2]
    colours = np.zeros((len(well), 3), np.float32)
    colours[well] = picture[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return colours
