"""Files about the camera: OpenCV's FileStorage, ROS's camera_info, Kalibr's camchain.

All three put (0, 0) at the centre of the first pixel, Koala at its corner: principal points are shifted by half a pixel here.
"""

from typing import Any

import cv2
import numpy as np
import yaml

from koala3d.calib.arrays import Array
from koala3d.calib.export.lens import BROWN4, BROWN5, FISHEYE, RATIONAL, Model, held
from koala3d.calib.export.source import Source
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import opencv_from_pixels

OPENCV = (Model("brown", BROWN5), Model("rational", RATIONAL), Model("fisheye", FISHEYE, True))
ROS = (Model("plumb_bob", BROWN5), Model("rational_polynomial", RATIONAL), Model("equidistant", FISHEYE, True))
KALIBR = (Model("none", ()), Model("radtan", BROWN4), Model("equidistant", FISHEYE, True))


def opencv(source: Source) -> str:
    """`cv2.FileStorage` in YAML, with the keys of OpenCV's calibration sample, and each pose as a 4 x 4 matrix."""
    lens = held(source.calibration.camera, OPENCV, "OpenCV")
    notes = [*source.notes(), *lens.notes()]
    notes.append("fisheye_model 1: the coefficients are for cv2.fisheye, else for cv2.projectPoints and cv2.undistort.")
    if source.calibration.poses:
        notes.append("A matrix a_from_b takes coordinates in b to coordinates in a; the camera's axes are OpenCV's.")
    storage = cv2.FileStorage(".yaml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for note in notes:
        storage.writeComment(note)
    storage.write("image_width", lens.camera.width)
    storage.write("image_height", lens.camera.height)
    storage.write("fisheye_model", int(lens.model.fisheye))
    storage.write("camera_matrix", _matrix(lens.camera))
    storage.write("distortion_coefficients", np.array(lens.model.values(lens.camera))[:, None])
    for name, found in source.calibration.poses.items():
        storage.write(name, found.matrix)
    return str(storage.releaseAndGetString())


def camera_info(source: Source) -> str:
    """What ROS's camera_info_manager reads: a camera without a pose. The rectified picture has the same focal lengths."""
    lens = held(source.calibration.camera, ROS, "ROS")
    matrix = _matrix(lens.camera)
    content = {
        "image_width": lens.camera.width,
        "image_height": lens.camera.height,
        "camera_name": "camera",
        "camera_matrix": _rows(matrix),
        "distortion_model": lens.model.name,
        "distortion_coefficients": _rows(np.array(lens.model.values(lens.camera))[None]),
        "rectification_matrix": _rows(np.eye(3)),
        "projection_matrix": _rows(np.hstack([matrix, np.zeros((3, 1))])),
    }
    return commented([*source.notes(), *lens.notes(), "This format holds no pose."], content)


def camchain(source: Source) -> str:
    """Kalibr's camera chain of one camera."""
    lens = held(source.calibration.camera, KALIBR, "Kalibr")
    cx, cy = opencv_from_pixels([lens.camera.cx, lens.camera.cy]).tolist()
    camera = {
        "cam_overlaps": [],
        "camera_model": "pinhole",
        "distortion_coeffs": lens.model.values(lens.camera),
        "distortion_model": lens.model.name,
        "intrinsics": [lens.camera.fx, lens.camera.fy, cx, cy],
        "resolution": [lens.camera.width, lens.camera.height],
        "rostopic": "/camera/image_raw",
    }
    why = "Kalibr's poses are between cameras, and between camera and IMU: the pose on the arm is not in this file."
    return commented([*source.notes(), *lens.notes(), why], {"cam0": camera})


def commented(notes: list[str], content: dict[str, Any]) -> str:
    """YAML with comments in front."""
    body = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
    return "".join(f"# {note}\n" for note in notes) + body


def _matrix(camera: Camera) -> Array:
    """(3, 3) calibration matrix for OpenCV's pixels."""
    matrix = camera.matrix
    matrix[:2, 2] = opencv_from_pixels(matrix[:2, 2])
    return matrix


def _rows(matrix: Array) -> dict[str, Any]:
    """A matrix as camera_info has it."""
    return {"rows": matrix.shape[0], "cols": matrix.shape[1], "data": matrix.ravel().tolist()}
