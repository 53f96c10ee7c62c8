"""Shared by Blender's and nerfstudio's JSON: OpenGL camera axes and the variants of intrinsics."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import OPENCV_FROM_MITSUBA, OPENCV_FROM_OPENGL
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats.assemble import foreign_lens, listed_once
from koala3d.datasets.imaging import images

PINHOLES = frozenset(
    {"OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV", "PERSPECTIVE", "BROWN", "NONE", ""}
)
"""Names of lens models whose coefficients are among OpenCV's."""
FISHEYES = frozenset({"OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "FISHEYE", "SIMPLE_FISHEYE"})
FISHEYE = "OPENCV_FISHEYE"
PANORAMA = "cut perspective images from the panoramas, as 'ns-process-data images --camera-type equirectangular' does"
"""Remedy for lenses that see all around."""
DISTORTION_PARAMS = ("k1", "k2", "k3", "k4", "p1", "p2")
"""nerfstudio's order in `distortion_params`."""


def frames_of(content: Any, *, where: object) -> list[dict[str, Any]]:
    """The list of frames of a transforms file; raises DatasetError where there is none, or an image is listed twice."""
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not all(isinstance(f, dict) and isinstance(f.get("file_path"), str) for f in frames):
        raise DatasetError("holds no list of frames with a file_path", where=where)
    listed_once([frame["file_path"] for frame in frames], where=where)
    return frames


def axes(content: dict[str, Any]) -> NDArray[np.float64]:
    """Camera coordinates of a file in ours: OpenGL's (x right, y up, z back), or those that instant-ngp's keys state."""
    if content.get("from_na"):
        return np.eye(4)
    return OPENCV_FROM_MITSUBA if content.get("from_mitsuba") else OPENCV_FROM_OPENGL


def world_from_camera(
    frame: dict[str, Any], opencv_from_file: NDArray[np.float64] = OPENCV_FROM_OPENGL, *, where: object
) -> tuple[NDArray[np.float64], float]:
    """(4, 4) in our axes from a frame's `transform_matrix`, and the scale that its rotation has.

    The rotation is replaced by the nearest orthonormal one: files carry seven digits or fewer. A scale, as objects of Blender and
    models that were aligned have it, is divided out: it changes no direction.
    """
    if "transform_matrix" not in frame:
        raise DatasetError("frame has no transform_matrix", where=where)
    matrix, scale = pose.unscaled(frame["transform_matrix"])
    return pose.checked(pose.checked(matrix, where=where) @ opencv_from_file, where=where), scale


def transform_matrix(world_from_camera: NDArray[np.float64]) -> list[list[float]]:
    """`transform_matrix` of a pose in our axes."""
    return (world_from_camera @ OPENCV_FROM_OPENGL).tolist()


def camera(
    content: dict[str, Any], frame: dict[str, Any], image: Path, folder: Path, *, where: object, any_lens: bool = False
) -> Camera:
    """Intrinsics of one frame: its own keys override those of the file; a missing size comes from the image's header.

    k4 is the first coefficient below the line of OpenCV's rational model if k5, k6 or the lens model FULL_OPENCV say so, and else
    the fourth above it, which needs `any_lens`.

    Raises:
        DatasetError: the lens model is not supported, or there is no focal length.
    """
    keys = {**content, **frame}
    model = _lens_model(keys)
    fisheye = model in FISHEYES or bool(keys.get("is_fisheye", False))
    if model not in PINHOLES | FISHEYES:
        remedy = PANORAMA if model == "EQUIRECTANGULAR" else "undistort the images first, or convert the model to COLMAP's layout"
        raise DatasetError(f"camera model {model} is not supported", where=where, remedy=remedy)
    if keys.get("distortion_params") is not None:
        keys |= dict(zip(DISTORTION_PARAMS, keys["distortion_params"], strict=False))
    width, height = (int(keys["w"]), int(keys["h"])) if "w" in keys and "h" in keys else images.size(image)
    fx = keys.get("fl_x") or _focal(width, keys.get("camera_angle_x"))
    fy = keys.get("fl_y") or (_focal(height, keys.get("camera_angle_y")) if "fl_x" not in keys else None) or fx
    if not fy:
        raise DatasetError("no focal length", where=where, why="neither fl_x nor camera_angle_x is given")
    cx, cy = keys.get("cx", width / 2), keys.get("cy", height / 2)
    values = {"width": width, "height": height, "fx": fx or fy, "fy": fy, "cx": cx, "cy": cy, "fisheye": fisheye}
    rational = model == "FULL_OPENCV" or keys.get("k5") or keys.get("k6")
    terms = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3", *(("k4", "k5", "k6") if rational else ()))
    found = Camera.from_json(values | {k: keys.get(k) or 0.0 for k in terms}, where=where)
    fourth = 0.0 if fisheye or rational else float(keys.get("k4") or 0.0)
    if fourth and not any_lens:
        raise foreign_lens(f"with k4 = {fourth} as the fourth radial coefficient", folder, where=where)
    return PolynomialCamera.of(found, fourth) if fourth else found


@dataclass(frozen=True)
class PolynomialCamera(Camera):
    """A camera whose radial factor is 1 + k1 r^2 + k2 r^4 + k3 r^6 + fourth r^8, as nerfstudio reads k4 where no k5 or k6 stands
    beside it. Images are resampled from it; nothing else knows it.
    """

    fourth: float = 0.0

    @classmethod
    def of(cls, camera: Camera, fourth: float) -> Self:
        """The camera with a further coefficient."""
        return cls(**asdict(camera), fourth=fourth)

    @property
    def is_pinhole(self) -> bool:
        """False: there is a lens."""
        return False

    def radial(self, r2: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(radial factor at the squared radius `r2`, its derivative by r2), of any shape."""
        factor, slope = super().radial(r2)
        square = np.asarray(r2, np.float64)
        bent = self.fourth * square * square * square
        return factor + bent * square, slope + 4 * bent


def _lens_model(keys: dict[str, Any]) -> str:
    """Name of the lens model in capitals; instant-ngp states some of its lenses by keys of their own."""
    if keys.get("latlong") or keys.get("equirectangular"):
        return "EQUIRECTANGULAR"
    if any(key.startswith("ftheta_p") and value for key, value in keys.items()):
        return "F-THETA"
    return str(keys.get("camera_model") or "").upper()


def _focal(length: int, angle: float | None) -> float | None:
    """Focal length [px] of a field of view [rad] over a length [px]."""
    return 0.5 * length / float(np.tan(0.5 * float(angle))) if angle else None
