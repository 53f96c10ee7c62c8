"""Shared by Blender's and nerfstudio's JSON: OpenGL camera axes and the variants of intrinsics."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets import pose
from datasets.camera_model import Camera
from datasets.conventions import OPENCV_FROM_OPENGL
from datasets.core import files
from datasets.core.errors import DatasetError
from datasets.formats.assemble import listed_once
from datasets.imaging import images

SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".exr", ".JPG", ".PNG")
"""Suffixes that a `file_path` may lack."""
PINHOLES = frozenset({"OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", ""})
FISHEYE = "OPENCV_FISHEYE"
DISTORTION_PARAMS = ("k1", "k2", "k3", "k4", "p1", "p2")
"""nerfstudio's order in `distortion_params`."""


def frames_of(content: Any, *, where: object) -> list[dict[str, Any]]:
    """The list of frames of a transforms file; raises DatasetError where there is none, or an image is listed twice."""
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not all(isinstance(f, dict) and isinstance(f.get("file_path"), str) for f in frames):
        raise DatasetError("holds no list of frames with a file_path", where=where)
    listed_once([frame["file_path"] for frame in frames], where=where)
    return frames


def image_path(folder: Path, file_path: str, *, where: object) -> Path | None:
    """The existing image of a `file_path`, with or without suffix; None where there is none.

    Raises:
        DatasetError: the path is absolute or leaves the folder, also through a symbolic link.
    """
    for suffix in SUFFIXES:
        path = files.inside(folder, file_path + suffix, where=where)
        if path.is_file():
            return path
    return None


def world_from_camera(frame: dict[str, Any], *, where: object) -> NDArray[np.float64]:
    """(4, 4) in our axes from a frame's `transform_matrix` (camera x right, y up, z back).

    The rotation is replaced by the nearest orthonormal one: files carry seven digits or fewer.
    """
    if "transform_matrix" not in frame:
        raise DatasetError("frame has no transform_matrix", where=where)
    return pose.checked(pose.checked(frame["transform_matrix"], where=where) @ OPENCV_FROM_OPENGL, where=where)


def transform_matrix(world_from_camera: NDArray[np.float64]) -> list[list[float]]:
    """`transform_matrix` of a pose in our axes."""
    return (world_from_camera @ OPENCV_FROM_OPENGL).tolist()


def camera(content: dict[str, Any], frame: dict[str, Any], image: Path, *, where: object) -> Camera:
    """Intrinsics of one frame: its own keys override those of the file; a missing size comes from the image's header.

    Raises:
        DatasetError: the lens model is not supported, or there is no focal length.
    """
    keys = {**content, **frame}
    model = str(keys.get("camera_model", "")).upper()
    if model not in PINHOLES | {FISHEYE}:
        remedy = "undistort the images to a pinhole first"
        raise DatasetError(f"camera model {model} is not supported", where=where, remedy=remedy)
    if keys.get("distortion_params") is not None:
        keys |= dict(zip(DISTORTION_PARAMS, keys["distortion_params"], strict=False))
    fisheye = model == FISHEYE or bool(keys.get("is_fisheye", False))
    if keys.get("k4") and not fisheye:
        why, remedy = f"k4 = {keys['k4']}", "undistort the images to a pinhole first"
        raise DatasetError("distortion k4 is not supported", where=where, why=why, remedy=remedy)
    width, height = (int(keys["w"]), int(keys["h"])) if "w" in keys and "h" in keys else images.size(image)
    fx = keys.get("fl_x") or _focal(width, keys.get("camera_angle_x"))
    fy = keys.get("fl_y") or (_focal(height, keys.get("camera_angle_y")) if "fl_x" not in keys else None) or fx
    if not fy:
        raise DatasetError("no focal length", where=where, why="neither fl_x nor camera_angle_x is given")
    cx, cy = keys.get("cx", width / 2), keys.get("cy", height / 2)
    values = {"width": width, "height": height, "fx": fx or fy, "fy": fy, "cx": cx, "cy": cy}
    terms = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    return Camera.from_json(values | {k: keys.get(k, 0.0) for k in terms} | {"fisheye": fisheye}, where=where)


def _focal(length: int, angle: float | None) -> float | None:
    """Focal length [px] of a field of view [rad] over a length [px]."""
    return 0.5 * length / float(np.tan(0.5 * float(angle))) if angle else None
