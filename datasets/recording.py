"""A recording: the folder that a capture writes, safe against a kill at any moment.

    RECORDING/manifest.json    configuration and equipment: trajectory, rig, camera state, seed, versions
    RECORDING/frames.jsonl     one line per exposure, appended and flushed to the disk after its image
    RECORDING/images/*.png     lossless images
    RECORDING/truth/           of a simulation only; read by evaluation and nothing else

A frame counts once its line is complete; an image without a line is recorded again on resume.
"""

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from datasets import pose
from datasets.core import files
from datasets.core.errors import DatasetError, UsageError
from datasets.scene import checked_name

FORMAT, VERSION = "koala-recording", 1
MAX_BYTES = 2**28
"""Larger lists of frames are refused; one of ten thousand frames has a twentieth of this size."""
_KINDS: dict[str, tuple[type, ...]] = {
    **dict.fromkeys(("index", "host_time_ns", "device_ticks"), (int,)),
    **dict.fromkeys(("robot_time_s", "exposure_us", "settle_s"), (int, float)),
    **dict.fromkeys(("name", "split", "image", "sha256"), (str,)),
}
MANIFEST, FRAMES, IMAGES, TRUTH = "manifest.json", "frames.jsonl", "images", "truth"


@dataclass(frozen=True)
class Frame:
    """One exposure: pose of the arm, time, and image."""

    index: int
    """Index of the viewpoint in the trajectory."""
    name: str
    """Unique name, sorts in trajectory order ("000", "001", ...)."""
    split: str
    """"train" or "test"; "calibration" for a target session."""
    image: str
    """Path of the image relative to the recording."""
    base_from_flange: NDArray[np.float64]
    """(4, 4) as the controller reported it after settling [m]."""
    joints: NDArray[np.float64]
    """(6,) measured joint angles [rad]."""
    robot_time_s: float
    """The controller's own time stamp [s]."""
    host_time_ns: int
    """Monotonic host clock at exposure [ns]."""
    device_ticks: int
    """The camera's time stamp at exposure."""
    exposure_us: float
    """Exposure time as read back from the camera [us]."""
    settle_s: float
    """Time from the end of the motion to the exposure [s]."""
    sha256: str
    """Of the image file."""

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary of the fields, arrays as lists."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Frame from `to_json`'s dictionary; raises DatasetError where it is not valid."""
        try:
            arrays = {"joints": np.asarray(content["joints"], np.float64)}
            arrays["base_from_flange"] = pose.checked(content["base_from_flange"], where=where)
            frame = cls(**{**content, **arrays})
            for key, kinds in _KINDS.items():
                value = getattr(frame, key)
                if not isinstance(value, kinds) or (float in kinds and not np.isfinite(value)):
                    raise ValueError(f"{key} is {str(value)[:40]!r}")
        except (TypeError, KeyError, ValueError, OverflowError) as error:
            raise DatasetError("frame record is not complete", where=where, why=str(error)) from None
        checked_name(frame.name, where=where)
        if frame.joints.shape != (6,) or not np.isfinite(frame.joints).all():
            raise DatasetError("joint angles are not six finite numbers", where=where)
        return frame


@dataclass(frozen=True)
class Recording:
    """A recording on disk. `manifest` is the argument of `create` with format and version added."""

    path: Path
    manifest: dict[str, Any]
    frames: list[Frame] = field(default_factory=list)

    @classmethod
    def create(cls, path: Path, manifest: dict[str, Any]) -> Self:
        """Start a new recording in a folder that is missing or empty. Raises UsageError where it is not empty."""
        path = Path(path)
        files.refuse_existing(path)
        files.make_folder(path / IMAGES)
        manifest = {"format": FORMAT, "version": VERSION, **manifest}
        files.write_json(path / MANIFEST, manifest)
        return cls(path, manifest)

    @classmethod
    def open(cls, path: Path) -> Self:
        """Read a recording, complete or not. A last line cut off by a kill is dropped; any other damage raises."""
        path = Path(path)
        if not (path / MANIFEST).is_file():
            why, remedy = f"no {MANIFEST} in it", "give a folder made by 'capture run'"
            raise UsageError("is not a recording", where=path, why=why, remedy=remedy)
        manifest = files.read_json(files.inside(path, MANIFEST), kind=FORMAT, version=VERSION)
        lines = _lines(files.inside(path, FRAMES))
        frames = []
        for number, line in enumerate(lines[:-1], 1):  # text after the last newline is an incomplete line
            where = f"{path / FRAMES}, line {number}"
            try:
                content = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise DatasetError("frame record is not valid JSON", where=where, why=str(error)) from None
            frame = Frame.from_json(content, where=where)
            files.inside(path, frame.image, where=where)
            frames.append(frame)
        return cls(path, manifest, frames)

    def append(self, frame: Frame) -> None:
        """Add a frame; returns once it is on the disk. Its image must exist already."""
        path = self.path / FRAMES
        begun = path.exists()
        line = json.dumps(frame.to_json(), allow_nan=False) + "\n"
        with open(path, "r+b" if begun else "w+b") as file:
            for _ in self.frames:
                file.readline()
            file.seek(file.tell())
            file.truncate()  # drops an incomplete line left by a kill
            file.write(line.encode())
            file.flush()
            os.fsync(file.fileno())
        if not begun:
            files.flush(self.path)
        self.frames.append(frame)

    @property
    def trajectory(self) -> dict[str, Any]:
        """The resolved trajectory of the request."""
        return self.manifest["trajectory"]

    def image_path(self, frame: Frame) -> Path:
        """Path of a frame's image."""
        return self.path / frame.image


def _lines(path: Path) -> list[str]:
    """Text of a file split at each newline; none where the file is not there yet."""
    try:
        return files.read_regular(path, MAX_BYTES).decode("utf-8").split("\n") if os.path.lexists(path) else []
    except UnicodeDecodeError as error:
        raise DatasetError("is not a text file", where=path, why=str(error)) from None
