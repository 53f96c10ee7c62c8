"""ROS bags written by `rosbags`, as an arm with a camera leaves them behind."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.track import exponential, logarithm

KINDS = ("sqlite", "mcap", "ros1")
START_NS = 1_790_000_000_123_456_789
TRANSFORM = "tf2_msgs/msg/TFMessage"
TRANSFORM_ROS1 = "geometry_msgs/TransformStamped[] transforms\n"


class Writer:
    """An open bag of one of the `KINDS`; messages are built by the types of their generation of ROS."""

    def __init__(self, writer: Any, store: Any, ros1: bool) -> None:
        self.writer, self.store, self.ros1 = writer, store, ros1
        self._topics: dict[str, Any] = {}

    def message(self, name: str, /, **fields: Any) -> Any:
        """A message; `name` without its package's folder `msg`."""
        package, kind = name.split("/")
        return self.store.types[f"{package}/msg/{kind}"](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self.message("builtin_interfaces/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        extra = {"seq": 0} if self.ros1 else {}
        return self.message("std_msgs/Header", stamp=stamp, frame_id=frame, **extra)

    def write(self, topic: str, arrived_ns: int, message: Any) -> None:
        kind = message.__msgtype__
        if topic not in self._topics:
            self._topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self._topics[topic], arrived_ns, serialize(message, kind))

    def picture(self, topic: str, stamp_ns: int, picture: np.ndarray, encoding: str, arrived_ns: int | None = None) -> None:
        """A picture as it is to lie in the message."""
        height, width = picture.shape[:2]
        rows = np.ascontiguousarray(picture).view(np.uint8).reshape(height, -1)
        size = {"height": height, "width": width, "step": rows.shape[1], "is_bigendian": 0}
        message = self.message(
            "sensor_msgs/Image", header=self.header(stamp_ns, "camera"), encoding=encoding, data=rows.ravel(), **size
        )
        self.write(topic, arrived_ns or stamp_ns, message)

    def compressed(self, topic: str, stamp_ns: int, data: bytes, kind: str) -> None:
        header, values = self.header(stamp_ns, "camera"), np.frombuffer(data, np.uint8)
        self.write(topic, stamp_ns, self.message("sensor_msgs/CompressedImage", header=header, format=kind, data=values))

    def transform(self, topic: str, stamp_ns: int, parent: str, child: str, parent_from_child: np.ndarray) -> None:
        w, x, y, z = map(float, pose.quaternion(parent_from_child))
        rotation = self.message("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)
        place = dict(zip("xyz", map(float, parent_from_child[:3, 3]), strict=True))
        moved = self.message(
            "geometry_msgs/Transform", translation=self.message("geometry_msgs/Vector3", **place), rotation=rotation
        )
        header = self.header(stamp_ns, parent)
        one = self.message("geometry_msgs/TransformStamped", header=header, child_frame_id=child, transform=moved)
        self.write(topic, stamp_ns, self.message("tf2_msgs/TFMessage", transforms=[one]))

    def joints(self, stamp_ns: int, names: Sequence[str], angles: Iterable[float]) -> None:
        none = np.zeros(0)
        values = {"name": list(names), "position": np.array(list(angles)), "velocity": none, "effort": none}
        self.write("/joint_states", stamp_ns, self.message("sensor_msgs/JointState", header=self.header(stamp_ns, ""), **values))

    def camera_info(self, topic: str, stamp_ns: int, camera: Any) -> None:
        """That of a plain lens, in ROS's own pixel coordinates."""
        k = np.array([camera.fx, 0, camera.cx - 0.5, 0, camera.fy, camera.cy - 0.5, 0, 0, 1])
        d, r, p = np.array([camera.k1, camera.k2, camera.p1, camera.p2, camera.k3]), np.eye(3).ravel(), np.zeros(12)
        matrices = {"D": d, "K": k, "R": r, "P": p} if self.ros1 else {"d": d, "k": k, "r": r, "p": p}
        roi = self.message("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        size = {"height": camera.height, "width": camera.width, "distortion_model": "plumb_bob", "binning_x": 0, "binning_y": 0}
        message = self.message("sensor_msgs/CameraInfo", header=self.header(stamp_ns, "camera"), roi=roi, **size, **matrices)
        self.write(topic, stamp_ns, message)


@contextmanager
def writing(path: Path, kind: str) -> Iterator[Writer]:
    """Write a bag: the folder of a rosbag2, or the file of ROS 1."""
    pytest.importorskip("rosbags", reason="rosbags is absent: pip install 'koala-capture[ros]'")
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    if kind == "ros1":
        store.register(get_types_from_msg(TRANSFORM_ROS1, TRANSFORM))
        with Writer1(path) as writer:
            yield Writer(writer, store, True)
        return
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer2(path, version=8, storage_plugin=plugin) as writer:
        yield Writer(writer, store, False)


def way(poses: np.ndarray, rest_s: float, move_s: float, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and poses of a way that rests at each pose and moves smoothly in between; the speed is zero at both ends."""
    times = np.arange(0.0, len(poses) * (rest_s + move_s), 1 / rate_hz)
    return times, at(poses, times, rest_s, move_s)


def at(poses: np.ndarray, times: np.ndarray, rest_s: float, move_s: float) -> np.ndarray:
    """(n, 4, 4) places of that way at (n,) times [s]; the last pose holds on."""
    number = np.clip((times // (rest_s + move_s)).astype(int), 0, len(poses) - 1)
    following = np.minimum(number + 1, len(poses) - 1)
    share = np.clip((times - number * (rest_s + move_s) - rest_s) / move_s, 0, 1)
    share = share**3 * (10 - 15 * share + 6 * share**2)  # a minimum-jerk motion
    return poses[number] @ exponential(share[:, None] * logarithm(pose.inverse(poses[number]) @ poses[following]))


def jpeg(picture: np.ndarray, quality: int = 98) -> bytes:
    """A picture, red first, as a JPEG file."""
    return cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def apart(found: Calibration, wanted: Calibration) -> float:
    """Largest difference of two calibrations, in the two poses and the camera, in standard deviations of the wanted."""
    worst = 0.0
    for name in ("flange_from_camera", "base_from_board"):
        one, other = getattr(found, name), getattr(wanted, name)
        shift = 1e3 * np.abs(one.matrix[:3, 3] - other.matrix[:3, 3]) / other.translation_std_mm
        turn = np.rad2deg(np.abs(pose.rotation_vector(pose.inverse(other.matrix) @ one.matrix))) / other.rotation_std_deg
        worst = max(worst, shift.max(), turn.max())
    differences = [
        abs(getattr(found.camera, name) - getattr(wanted.camera, name)) / std for name, std in wanted.camera_std.items()
    ]
    return max(worst, *differences)
