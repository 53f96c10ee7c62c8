"""A recording: the folder that a capture writes, safe against a kill at any moment.

    RECORDING/manifest.json    configuration and equipment: trajectory, rig, camera state, seed, versions
    RECORDING/frames.jsonl     one line per exposure, appended and flushed to the disk after its image
    RECORDING/images/*.png     lossless images
    RECORDING/raw/*.png        of cameras with 12 bits: their raw values
    RECORDING/depth/*.png      of cameras that measure depth: 16 bits, see `DEPTH_KEYS`; a measurement, not truth
    RECORDING/session.log      what happened, one line per event; see `capture.recording.session_log`
    RECORDING/radiometry.npz   where it was measured: the response of the sensor, see `datasets.radiometry.response`
    RECORDING/track.npz        of a ROS bag only: the path of the flange, see `datasets.track`
    RECORDING/truth/           of a simulation only; read by evaluation and nothing else

A frame counts once its line is complete; an image without a line is recorded again on resume.
"""

import json
import os
from collections.abc import Collection
from dataclasses import MISSING, dataclass, field, fields
from datetime import datetime
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.kinematics import UR5E, Links
from koala3d.datasets.radiometry.response import Response
from koala3d.datasets.radiometry.stored import LARGEST, DepthPicture, Exposure
from koala3d.datasets.scene import checked_name
from koala3d.datasets.track import FILE as TRACK
from koala3d.datasets.track import Track

FORMAT, VERSION = "koala-recording", 1
MAX_BYTES = 2**28
"""Larger lists of frames are refused; one of ten thousand frames has a twentieth of this size."""
LARGEST_ANGLE = 1e4
"""Limit of a turntable's angle [rad]: 1600 turns."""
LEAST_TURN = float(np.radians(0.1))
"""Angles of a turntable that differ by less are one [rad]."""
MANIFEST, FRAMES, IMAGES, TRUTH = "manifest.json", "frames.jsonl", "images", "truth"
RADIOMETRY = "radiometry.npz"
POSE, UPRIGHT = "pose", "upright"
"""Part of the manifest with the name of the way in which the object lay, and that of the first session of an object."""
CHOSEN = "chosen"
"""Part of the manifest of a session that chose its own views; see `chosen_views`."""
BAG, MOVING = "bag", "moving"
"""Part of the manifest of a recording that was made of a ROS bag (`datasets.bags`), and the split of pictures of a moving arm,
which only tell how late time stamps are."""
DEPTH = "depth"
DEPTH_KEYS = ("unit_m", "camera", "distortion", "camera_from_depth")
"""What the manifest's camera says in its part `depth`: metres per step along z (0 is none measured), the intrinsics of the depth
pictures, their distortion as the camera's maker models it, and the (4, 4) pose of the depth sensor in the camera [m]."""


@dataclass(frozen=True, kw_only=True)
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
    """(n,) measured joint angles [rad]."""
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
    base_from_flange_after: NDArray[np.float64] | None = None
    """(4, 4) as the controller reported it after the exposure [m]; None where only the pose before it was kept."""
    joints_after: NDArray[np.float64] | None = None
    """(n,) measured joint angles after the exposure [rad]."""
    robot_time_after_s: float | None = None
    """The controller's time stamp of that [s]."""
    exposures: tuple[Exposure, ...] = ()
    """What the sensor read, longest exposure first. Empty: the image is all there is."""
    turntable_angle: float | None = None
    """The turntable's angle as its controller reported it before the exposure [rad]; None without a turntable."""
    turntable_angle_after: float | None = None
    """The same after the exposure [rad]."""
    lights: tuple[str, ...] | None = None
    """Names of the lamps of the rig that were on; None where nobody said."""
    depth: DepthPicture | None = None
    """Depth that the camera measured; None where it measures none."""
    wall_time: str | None = None
    """Wall-clock time of the exposure, UTC: 2026-11-28T02:38:30.123456Z; None in older recordings."""
    joint_temperatures: tuple[float, ...] | None = None
    """Temperatures of the joints before the exposure [degrees Celsius]; None where the controller does not report them."""

    @property
    def files(self) -> tuple[str, ...]:
        """All its files, relative to the recording; the image first."""
        beside = (exposure.file for exposure in self.exposures)
        return (self.image, *beside, *(() if self.depth is None else (self.depth.file,)))

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary of the fields, arrays as lists."""
        content = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}
        depth = {} if self.depth is None else {"depth": vars(self.depth)}
        del content["depth"]
        return {**content, "exposures": [vars(one) for one in self.exposures], **depth}

    @classmethod
    def from_json(cls, content: Any, *, where: object, joints: int = UR5E.count) -> Self:
        """Frame of an arm with so many joints from `to_json`'s dictionary; raises DatasetError where it is not valid."""
        try:
            arrays = {"joints": np.asarray(content["joints"], np.float64)}
            arrays["base_from_flange"] = pose.checked(content["base_from_flange"], where=where)
            if content.get("base_from_flange_after") is not None:
                arrays["joints_after"] = np.asarray(content["joints_after"], np.float64)
                arrays["base_from_flange_after"] = pose.checked(content["base_from_flange_after"], where=where)
                if not abs(content["robot_time_after_s"]) < LARGEST:
                    raise ValueError(f"robot_time_after_s is {content['robot_time_after_s']!r:.80}")
            taken: dict[str, Any] = {"exposures": tuple(Exposure.from_json(one) for one in content.get("exposures", ()))}
            taken |= {name: _angle(content, name) for name in ("turntable_angle", "turntable_angle_after")}
            taken["lights"] = _names(content.get("lights"))
            if content.get("joint_temperatures") is not None:
                taken["joint_temperatures"] = tuple(map(float, content["joint_temperatures"]))
                if not all(abs(value) < LARGEST for value in taken["joint_temperatures"]):
                    raise ValueError(f"joint_temperatures is {content['joint_temperatures']!r:.80}")
            if content.get("wall_time") is not None:
                datetime.fromisoformat(content["wall_time"])
            if content.get("depth") is not None:
                taken["depth"] = DepthPicture.from_json(content["depth"])
            for one in fields(cls):
                if one.default is not MISSING:
                    continue
                kind, given = cast(Any, one.type), content[one.name]
                if kind in (str, int, float) and (kind(given) != given or (kind is not str and not abs(given) < LARGEST)):
                    raise ValueError(f"{one.name} is {given!r:.80}")
            frame = cls(**{**content, **arrays, **taken})
        except (TypeError, KeyError, ValueError, OverflowError) as error:
            raise DatasetError("frame record is not complete", where=where, why=str(error)) from None
        checked_name(frame.name, where=where)
        for angles in (frame.joints, frame.joints if frame.joints_after is None else frame.joints_after):
            if angles.shape != (joints,) or not np.isfinite(angles).all():
                raise DatasetError(f"joint angles are not {joints} finite numbers", where=where)
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
        frames, joints = [], cls(path, manifest).links.count
        for number, line in enumerate(lines[:-1], 1):  # text after the last newline is an incomplete line
            where = f"{path / FRAMES}, line {number}"
            try:
                content = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise DatasetError("frame record is not valid JSON", where=where, why=str(error)) from None
            frame = Frame.from_json(content, where=where, joints=joints)
            for name in frame.files:
                files.inside(path, name, where=where)
            frames.append(frame)
        return cls(path, manifest, frames)

    def append(self, frame: Frame) -> None:
        """Add a frame; returns once it is on the disk. Its image must exist already, and its name be on the disk.

        Raises DatasetError: another process has added frames meanwhile; nothing is changed.
        """
        path = self.path / FRAMES
        line, new = json.dumps(frame.to_json(), allow_nan=False) + "\n", not path.exists()
        with open(path, "w+b" if new else "r+b") as file:
            for _ in self.frames:
                file.readline()
            end = file.tell()
            if b"\n" in file.read():
                why, remedy = (
                    f"it holds more than the {len(self.frames)} frames that this session knows",
                    "let one session record",
                )
                raise DatasetError("another process records here", where=path, why=why, remedy=remedy)
            file.seek(end)
            file.truncate()  # drops an incomplete line left by a kill
            file.write(line.encode())
            file.flush()
            os.fsync(file.fileno())
        if new:
            files.flush(self.path)
        self.frames.append(frame)

    def discard(self, names: Collection[str]) -> list[str]:
        """Remove frames, so that they can be taken again; returns the names of those that existed.

        Their lines are removed first, in one step, then their images. A kill in between leaves an image without a line, as a
        kill during a capture does.
        """
        removed = [frame for frame in self.frames if frame.name in names]
        if removed:
            lines = zip(_lines(self.path / FRAMES), self.frames, strict=False)
            files.write_text(self.path / FRAMES, "".join(f"{line}\n" for line, frame in lines if frame.name not in names))
        self.frames[:] = [frame for frame in self.frames if frame.name not in names]
        for frame in removed:
            for name in frame.files:
                (self.path / name).unlink(missing_ok=True)
        return [frame.name for frame in removed]

    @property
    def trajectory(self) -> dict[str, Any]:
        """The resolved trajectory of the request. Raises DatasetError where the manifest has none."""
        trajectory = self.manifest.get("trajectory")
        if not isinstance(trajectory, dict):
            raise DatasetError("the manifest has no trajectory", where=self.path / MANIFEST, remedy="record it again")
        return trajectory

    def part(self, name: str) -> dict[str, Any]:
        """What the manifest says of the robot, the camera or another part; empty where it says nothing."""
        content = self.manifest.get(name)
        return content if isinstance(content, dict) else {}

    @property
    def pose(self) -> str:
        """Name of the way in which the object lay: a person may turn it over between two sessions."""
        return str(self.manifest.get(POSE) or UPRIGHT)

    @property
    def planned_views(self) -> int | None:
        """How many views of the object the trajectory has; None where it does not say how they are split."""
        split = self.part("trajectory").get("split")
        counts = [split.get(name) for name in ("train", "test")] if isinstance(split, dict) else [None]
        return sum(counts) if all(isinstance(count, int) for count in counts) else None

    def response(self, given: Path | None = None) -> Response | None:
        """The response of the sensor: that of a file, else the recording's own; None where there is none.

        Raises UsageError: it belongs to another camera, region or gain. DatasetError: it is not the one of the recording.
        """
        stated = self.part("radiometry").get("sha256")
        path = given or self.path / RADIOMETRY
        if given is None and stated is None:
            return None
        if given is None and files.sha256(path) != stated:
            why = "its SHA-256 differs from the manifest's"
            raise DatasetError("is not the response that was recorded", where=path, why=why, remedy="restore it")
        return Response.load(path).of_camera(self.part("camera"), where=path)

    @property
    def turns(self) -> bool:
        """Whether the object turned on a table between the frames."""
        angles = [frame.turntable_angle for frame in self.frames if frame.turntable_angle is not None]
        return bool(angles and max(angles) - min(angles) > LEAST_TURN)

    @property
    def links(self) -> Links:
        """The nominal chain of the arm; that of the UR5e where the manifest names no arm."""
        content = self.part("arm").get("dh")
        return UR5E if content is None else Links.from_json(content, where=f"{self.path / MANIFEST}, arm")

    @property
    def region(self) -> Region | None:
        """The region of the sensor that the images show; None where the manifest does not say it."""
        content = self.part("camera").get("region")
        return None if content is None else Region.from_json(content, where=f"{self.path / MANIFEST}, camera, region")

    @property
    def is_of_a_bag(self) -> bool:
        """Whether it was made of a ROS bag: joint angles and exposures are not known then, and the path of the flange is."""
        return BAG in self.manifest

    @property
    def track(self) -> Track | None:
        """The path of the flange, if it was made of a ROS bag."""
        return Track.load(self.path / TRACK) if self.is_of_a_bag else None

    def image_path(self, frame: Frame) -> Path:
        """Path of a frame's image."""
        return self.path / frame.image


def chosen_views(recording: Recording) -> dict[str, dict[str, Any]]:
    """Why each view was taken, by name; empty where the session did not choose its views."""
    views = recording.part(CHOSEN).get("views")
    return {name: why for name, why in views.items() if isinstance(why, dict)} if isinstance(views, dict) else {}


def _angle(content: dict[str, Any], name: str) -> float | None:
    """An angle of a frame's dictionary, where it has one; raises ValueError where it is not credible."""
    given = content.get(name)
    if given is not None and not (isinstance(given, int | float) and abs(given) < LARGEST_ANGLE):
        raise ValueError(f"{name} is {given!r:.80}")
    return None if given is None else float(given)


def _names(given: Any) -> tuple[str, ...] | None:
    """Names of lamps of a frame's dictionary; raises ValueError where they are none."""
    if given is not None and not (isinstance(given, list | tuple) and all(isinstance(name, str) for name in given)):
        raise ValueError(f"lights is {given!r:.80}")
    return None if given is None else tuple(given)


def _lines(path: Path) -> list[str]:
    """Text of a file split at each newline; none where the file is not there yet."""
    try:
        return files.read_regular(path, MAX_BYTES).decode("utf-8").split("\n") if os.path.lexists(path) else []
    except UnicodeDecodeError as error:
        raise DatasetError("is not a text file", where=path, why=str(error)) from None
