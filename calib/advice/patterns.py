"""Views drawn at random around a board."""

from dataclasses import dataclass

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.targets.board import Board

Generator = np.random.Generator


@dataclass(frozen=True)
class Rig:
    """What stands where, and what the camera is."""

    camera: Camera
    board: Board
    flange_from_camera: Array  # (4, 4)
    base_from_board: Array  # (4, 4)


@dataclass(frozen=True)
class ViewRange:
    """How views lie around the board: each quantity is drawn evenly from its range."""

    tilt_deg: tuple[float, float] = (0.0, 35.0)  # between the optical axis and the board's normal; even over the sphere's surface
    distance_m: tuple[float, float] = (0.4, 0.6)  # from the camera to the point that it looks at
    roll_deg: tuple[float, float] = (-180.0, 180.0)  # about the optical axis
    shift_m: float = 0.03  # the point looked at lies up to this far beside the board's middle, along x and along y


def viewpoints(rng: Generator, rig: Rig, views: int, pattern: ViewRange) -> Array:
    """(views, 4, 4) base_from_camera on the board's seen side."""
    board = rig.base_from_board
    middle = np.append(rig.board.points[:, :2].mean(0), 0.0)
    low, high = np.deg2rad(pattern.tilt_deg)
    tilt = np.arccos(rng.uniform(np.cos(high), np.cos(low), views))
    side, roll = rng.uniform(0, 2 * np.pi, views), np.deg2rad(rng.uniform(*pattern.roll_deg, views))
    shift = np.column_stack([rng.uniform(-1, 1, (views, 2)) * pattern.shift_m, np.zeros(views)])
    tilts = pose.from_rotation_vector(tilt[:, None] * np.column_stack([np.cos(side), np.sin(side), 0 * side]))
    rolls = pose.from_rotation_vector(roll[:, None] * np.array([0.0, 0.0, 1.0]))
    board_from_camera = tilts @ rolls  # at no tilt the camera looks along the board's z axis, into it
    distance = rng.uniform(*pattern.distance_m, views)
    board_from_camera[:, :3, 3] = middle + shift - distance[:, None] * board_from_camera[:, :3, 2]
    return board @ board_from_camera
