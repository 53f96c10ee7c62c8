"""Messages of ROS bags: rosbag2 (SQLite, MCAP) and ROS 1, through `rosbags`, which this module alone imports."""

from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from koala3d.datasets.core.errors import DatasetError, KoalaError, UsageError

SUFFIXES = (".bag", ".mcap", ".db3")
"""Of bags that are single files."""
METADATA = "metadata.yaml"
"""File in the folder of a rosbag2."""
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, JOINTS, TEXT = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/JointState", "std_msgs/msg/String"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types of messages, as `rosbags` names them for both generations of ROS."""


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS bag: a file, the folder of a rosbag2, or a folder of ROS 1 files that belong together."""
    if path.is_dir():
        return (path / METADATA).is_file() or any(path.glob("*.bag"))
    return path.is_file() and path.suffix in SUFFIXES


def files_of(path: Path) -> list[Path]:
    """Files of a bag in the order of their names; what is beside them in its folder included."""
    return sorted(one for one in path.iterdir() if one.is_file()) if path.is_dir() else [path]


@dataclass(frozen=True)
class Message:
    """A message with its place and times."""

    topic: str
    stamp_ns: int
    """Time stamp of its header; the time of its arrival if it has none [ns]."""
    content: Any
    stamped: bool
    """Whether it had a time stamp of its own."""


class Bag:
    """An open bag."""

    def __init__(self, path: Path, reader: Any) -> None:
        self.path, self._reader = path, reader

    def topics(self, *types: str) -> dict[str, int]:
        """Topics of these types that hold messages, with the number of messages."""
        found: dict[str, int] = {}
        for connection in self._reader.connections:
            if connection.msgtype in types and connection.msgcount:
                found[connection.topic] = found.get(connection.topic, 0) + connection.msgcount
        return found

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics in the order of their arrival. Raises DatasetError if one is damaged."""
        chosen = [connection for connection in self._reader.connections if connection.topic in topics]
        if not chosen:
            return
        with translated(self.path):
            for connection, arrived_ns, raw in self._reader.messages(chosen):
                content = self._reader.deserialize(raw, connection.msgtype)
                header = getattr(content, "header", None)
                stamp = 0 if header is None else stamp_ns(header)
                yield Message(connection.topic, stamp or arrived_ns, content, stamp > 0)


def stamp_ns(header: Any) -> int:
    """Time stamp of a header [ns]."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """Open a bag. Raises DatasetError if it cannot be read, UsageError for a pipe, ModuleNotFoundError without `rosbags`."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    for one in path.iterdir() if path.is_dir() else [path]:
        if one.exists() and not one.is_file() and not one.is_dir():  # `rosbags` would wait for a pipe's writer
            raise UsageError("is not a file", where=one, why="it is a pipe or a device", remedy="copy the bag again")
    whole = path.is_dir() and not (path / METADATA).is_file()
    parts = sorted(path.glob("*.bag")) if whole else [path]
    with ExitStack() as stack:
        with translated(path):
            reader = stack.enter_context(AnyReader(parts, default_typestore=get_typestore(Stores.LATEST)))
        yield Bag(path, reader)


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Turn what `rosbags` and the libraries below it raise of a damaged bag into a DatasetError."""
    try:
        yield
    except (KoalaError, ModuleNotFoundError):
        raise
    except MemoryError:
        why, remedy = "a length in it asks for more memory than there is", "copy the bag again"
        raise DatasetError("bag cannot be read", where=path, why=why, remedy=remedy) from None
    except FileNotFoundError as error:
        raise UsageError("bag is not complete", where=path, why=str(error), remedy="copy the whole folder") from error
    except Exception as error:  # of SQLite, LZ4, Zstandard and YAML as well: their classes have no common base
        why, remedy = f"{type(error).__name__}: {str(error)[:200]}", "ROS can mend it: ros2 bag reindex, or rosbag reindex"
        raise DatasetError("bag cannot be read", where=path, why=why, remedy=remedy) from error
