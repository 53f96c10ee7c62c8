"""Camera paths for films: an orbit around the object, or a smooth curve through given poses.

    fps: 30
    seconds: 6
    closed: true            # the last pose leads back to the first
    poses:
      - {position: [0.6, 0.2, 0.4], target: [0.4, 0.0, 0.15]}
      - {position: [0.2, 0.5, 0.4], target: [0.4, 0.0, 0.15], up: [0, 0, 1]}

Positions in the scene's world coordinates.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.interpolate import CubicSpline

from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import Schema, load_yaml
from koala3d.datasets.scene import Scene

Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]
Vector = tuple[Coordinate, Coordinate, Coordinate]


class KeyPose(Schema):
    """Position and target of the camera."""

    position: Vector = Field(description="Position of the camera in world coordinates.")
    target: Vector = Field(description="Point that the camera looks at.")
    up: Vector = Field(default=(0, 0, 1), description="Up direction of the image.")


class PathFile(Schema):
    """A file that describes a camera path."""

    fps: float = Field(default=30, gt=0, le=240, description="Frames per second.")
    seconds: float = Field(default=6, gt=0, le=3600, description="Length of the film.")
    closed: bool = Field(default=False, description="Whether the last pose leads back to the first.")
    poses: tuple[KeyPose, ...] = Field(min_length=2, description="Poses along the path, at equal times.")


def from_file(path: Path) -> tuple[list[NDArray[np.float64]], float]:
    """`world_from_camera` of each frame, and frames per second.

    Raises UsageError: the file is missing or invalid, or a camera would look along its up direction.
    """
    content = load_yaml(path, PathFile)
    return frames_of(content, where=path), content.fps


def frames_of(content: PathFile, *, where: object = "") -> list[NDArray[np.float64]]:
    """(4, 4) `world_from_camera` of each frame of a path. Raises UsageError if a camera would look along its up direction."""
    keys = content.poses + (content.poses[:1] if content.closed else ())
    columns = np.array([[*key.position, *key.target, *key.up] for key in keys], np.float64)
    curve = CubicSpline(np.arange(len(keys)), columns, bc_type="periodic" if content.closed else "natural")
    count = max(2, round(content.seconds * content.fps))
    at = np.linspace(0, len(keys) - 1, count, endpoint=not content.closed)
    frames = []
    for values in curve(at):
        position, target, up = values[:3], values[3:6], values[6:]
        if np.linalg.norm(np.cross(target - position, up)) < 1e-6:
            why, advice = f"at {position.round(3).tolist()}", "move the pose, or give another up"
            raise UsageError("camera looks along its up direction, or at its own position", where=where, why=why, remedy=advice)
        frames.append(pose.look_at(position, target, up))
    return frames


def orbit(scene: Scene, count: int) -> list[NDArray[np.float64]]:
    """`world_from_camera` of `count` frames on a circle around the centre of the object's box.

    The circle has the training cameras' mean distance, elevation and up direction.
    """
    centre = np.asarray(scene.box, np.float64).mean(0)
    cameras = np.stack([view.world_from_camera for view in scene.views])
    up = -cameras[:, :3, 1].mean(0)  # y points down in a camera
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > 1e-3 else np.array([0, 0, 1.0])
    offset = cameras[:, :3, 3] - centre
    height = float(np.median(offset @ up))
    across = offset - (offset @ up)[:, None] * up
    radius = max(float(np.median(np.linalg.norm(across, axis=-1))), 1e-6)
    first = across[np.argmax(np.linalg.norm(across, axis=-1))]
    first = first / max(np.linalg.norm(first), 1e-12)
    second = np.cross(up, first)
    angles = 2 * np.pi * np.arange(count) / count
    places = centre + height * up + radius * (np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second)
    return [pose.look_at(place, centre, up) for place in places]
