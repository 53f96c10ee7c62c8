"""Pictures of image messages: as files, and how sharp they are.

Compressed pictures are kept as they came. Names of encodings are those of sensor_msgs/image_encodings.h.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images

SIDE = 640
"""Sharpness is measured in pictures of at most this side [px]."""
DEPTHS = ("16UC1", "32FC1")
"""Encodings of depth, which are no photographs."""
PLAIN = {
    "mono8": 1,
    "8UC1": 1,
    "rgb8": 3,
    "bgr8": 3,
    "8UC3": 3,
    "rgba8": 4,
    "bgra8": 4,
    "8UC4": 4,
    "mono16": 1,
    "rgb16": 3,
    "bgr16": 3,
}
"""Channels of encodings that hold one value after the other. 8UC3 and 8UC4 are OpenCV's own: blue first."""
BLUE_FIRST = ("bgr8", "8UC3", "bgra8", "8UC4", "bgr16")
BAYER = {name: getattr(cv2, f"COLOR_Bayer{name.upper()}2RGB") for name in ("rggb", "bggr", "gbrg", "grbg")}
"""Conversion of each mosaic by its upper left four pixels, as ROS and, since 4.5, OpenCV name it."""
INTERLEAVED = {
    "yuv422": cv2.COLOR_YUV2RGB_UYVY, "uyvy": cv2.COLOR_YUV2RGB_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2, "yuyv": cv2.COLOR_YUV2RGB_YUY2,
}  # fmt: skip
BROWN = ("k1", "k2", "p1", "p2", "k3")
FISHEYE = "equidistant"
LENSES = {"plumb_bob": BROWN, "rational_polynomial": (*BROWN, "k4", "k5", "k6"), FISHEYE: ("k1", "k2", "k3", "k4"), "": ()}
"""Coefficients of a camera_info in their order, by the name of the model; no name: no distortion."""
MARKS = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg"}
"""Suffix of what begins with these bytes."""


def decoded(message: Any, *, where: object) -> NDArray[Any]:
    """(height, width, 1, 3 or 4) sRGB values of an image message, 8 or 16 bits, red first. Raises DatasetError if it has none."""
    if not hasattr(message, "encoding"):
        return _of_file(message, where)
    encoding, wide = message.encoding, message.encoding.endswith("16")
    if encoding in INTERLEAVED:
        return _converted(_rows(message, 2, np.uint8, where), INTERLEAVED[encoding], where)
    mosaic = re.fullmatch(r"bayer_(\w{4})(8|16)", encoding)
    if mosaic and mosaic[1] in BAYER:
        return _converted(_rows(message, 1, np.uint16 if wide else np.uint8, where), BAYER[mosaic[1]], where)
    if encoding not in PLAIN:
        why = f"encoding {encoding!r}; read are {', '.join((*PLAIN, *INTERLEAVED))} and bayer_*"
        raise DatasetError("picture has an unknown encoding", where=where, why=why, remedy="convert it with image_proc")
    picture = _rows(message, PLAIN[encoding], np.uint16 if wide else np.uint8, where)
    return picture[..., [2, 1, 0, 3][: picture.shape[-1]]] if encoding in BLUE_FIRST else picture


def _converted(values: NDArray[Any], code: int, where: object) -> NDArray[Any]:
    """(height, width, 3) colours of a mosaic or of interleaved values; DatasetError for fewer than two pixels along a side."""
    try:
        return np.asarray(cv2.cvtColor(values, code))
    except cv2.error as error:
        why = f"{values.shape[1]}x{values.shape[0]} pixels, {error.err}"
        raise DatasetError("picture cannot be converted", where=where, why=why) from None


def _rows(message: Any, channels: int, kind: type, where: object) -> NDArray[Any]:
    """(height, width, channels) values of a message in this machine's order of bytes; rows may be padded."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    size = np.dtype(kind).itemsize
    used = width * channels * size
    if not (height > 0 and width > 0 and step >= used and len(message.data) >= height * step):
        why = f"{width}x{height} with {step} bytes a row, {len(message.data)} bytes in all"
        raise DatasetError("picture is not complete", where=where, why=why)
    rows = np.asarray(message.data, np.uint8)[: height * step].reshape(height, step)[:, :used]
    order = ">" if message.is_bigendian else "<"
    return np.ascontiguousarray(rows).view(np.dtype(kind).newbyteorder(order)).reshape(height, width, channels).astype(kind)


def _of_file(message: Any, where: object) -> NDArray[Any]:
    """The picture of a compressed message; one that is compressed as a mosaic is developed.

    It is decoded as a file, with the limits of files.
    """
    data = bytes(message.data)
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"picture{_suffix(data)}"
        path.write_bytes(data)
        try:
            picture = images.read_stored(path)
        except DatasetError as error:
            why = f"{error.why}; its format says {message.format[:80]!r}"
            raise DatasetError("picture cannot be decoded", where=where, why=why) from None
    mosaic = re.match(r"bayer_(\w{4})(8|16)", message.format)
    if picture.shape[-1] == 1 and mosaic and mosaic[1] in BAYER:
        return _converted(picture, BAYER[mosaic[1]], where)
    return picture


def _suffix(data: bytes) -> str:
    """Of a PNG or JPEG; empty for other data."""
    return next((suffix for mark, suffix in MARKS.items() if data.startswith(mark)), "")


def write(message: Any, folder: Path, name: str, *, where: object) -> tuple[str, tuple[int, int]]:
    """Write the picture of a message below `folder`; returns its path there, and width and height."""
    picture = decoded(message, where=where)
    size = picture.shape[1], picture.shape[0]
    if not hasattr(message, "encoding") and not message.format.startswith("bayer"):
        data = bytes(message.data)
        if suffix := _suffix(data):
            files.write_bytes(folder / f"{name}{suffix}", data)
            return f"{folder.name}/{name}{suffix}", size
    images.write(folder / f"{name}.png", picture)
    return f"{folder.name}/{name}.png", size


def sharpness(message: Any, *, where: object) -> float:
    """Variance of the Laplacian of the brightness, relative to that of the brightness: exposure does not change it."""
    picture = decoded(message, where=where)
    grey = picture[..., :3].mean(-1).astype(np.float32)
    if (shrink := max(grey.shape) / SIDE) > 1:
        small = round(grey.shape[1] / shrink), round(grey.shape[0] / shrink)
        grey = np.asarray(cv2.resize(grey, small, interpolation=cv2.INTER_AREA))
    return float(cv2.Laplacian(grey, cv2.CV_32F).var() / max(float(grey.var()), 1e-12))


@dataclass(frozen=True)
class CameraInfo:
    """What a `camera_info` says, in its own words."""

    width: int
    height: int
    model: str
    k: list[float]
    """(9,) camera matrix, row by row; pixel centres at integers [px]."""
    d: list[float]
    """Coefficients of the model: plumb_bob k1 k2 p1 p2 k3, rational_polynomial and equidistant as OpenCV has them."""
    offset: tuple[int, int]
    binning: tuple[int, int]

    @classmethod
    def of(cls, message: Any) -> "CameraInfo":
        """From the message of either generation of ROS."""
        k, d = (message.k, message.d) if hasattr(message, "k") else (message.K, message.D)
        roi, binning = message.roi, (max(int(message.binning_x), 1), max(int(message.binning_y), 1))
        numbers = [float(value) for value in k], [float(value) for value in d]
        size = int(message.width), int(message.height)
        return cls(*size, message.distortion_model, *numbers, (int(roi.x_offset), int(roi.y_offset)), binning)

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> "CameraInfo":
        """From the fields of one. Raises DatasetError where they are not complete."""
        try:
            numbers = [[float(value) for value in content[key]] for key in ("k", "d")]
            (left, top), (wide, high) = ([int(value) for value in content[key]] for key in ("offset", "binning"))
            size = int(content["width"]), int(content["height"])
            return cls(*size, str(content["model"]), *numbers, (left, top), (max(wide, 1), max(high, 1)))
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise DatasetError("camera_info is not complete", where=where, why=str(error)) from None

    def camera(self, width: int, height: int, *, where: object) -> Camera | None:
        """The camera of pictures of this size [px]; None if it is not calibrated, has another lens model or another size.

        The message describes the whole sensor; pictures show the region from `offset` on, binned (sensor_msgs/CameraInfo).
        """
        names = LENSES.get(self.model, ())
        across, down = self.binning
        whole = (self.width - self.offset[0]) // across, (self.height - self.offset[1]) // down
        if len(self.k) != 9 or not self.k[0] or len(self.d) > len(names) or width > whole[0] or height > whole[1]:
            return None
        if not any(self.offset) and (width, height) != whole:
            return None
        (fx, _, cx, _, fy, cy), lens = self.k[:6], dict(zip(names, self.d, strict=False))
        centre = (cx + 0.5 - self.offset[0]) / across, (cy + 0.5 - self.offset[1]) / down
        found = Camera(width, height, fx / across, fy / down, *centre, **lens, fisheye=self.model == FISHEYE)
        return found.checked(where=where)
