"""Target sessions: the corners of each view, the pose that the arm reported, and the provenance of both."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.calib.arrays import Array, Mask
from koala3d.calib.errors import TargetError
from koala3d.calib.targets import inner_corners
from koala3d.calib.targets.detection import Observation, detect, read_board
from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.kinematics import UR5E, Links
from koala3d.datasets.recording import BAG, FRAMES, MANIFEST, MOVING, Recording
from koala3d.datasets.targets.board import Board
from koala3d.datasets.track import Track


@dataclass(frozen=True, eq=False)
class Reading:
    """What the poses of a file would be if its numbers meant something else than was said."""

    kind: str  # for instance: Euler angles ZYX in degrees
    description: str  # what would have to be said for that
    base_from_flange: Array  # (views, 4, 4)


@dataclass(frozen=True, eq=False)
class Clocked:
    """Pictures on a clock of their own beside the path of the flange: how late their stamps are can be measured."""

    track: Track
    stamps_ns: NDArray[np.int64]  # (views,) of the session's views
    moving: tuple[Observation, ...] = ()  # of a moving arm between halts, which take no part in anything else
    moving_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    halts: bool = True  # whether the views are of a resting arm: then their poses do not depend on the latency

    def chosen(self, rows: list[int]) -> Self:
        """The same of some of the session's views."""
        return replace(self, stamps_ns=self.stamps_ns[rows])


@dataclass(frozen=True)
class TargetSession:
    """Views in which the target was found, and the names of those in which it was not."""

    board: Board
    width: int  # of every image [px]
    height: int
    observations: tuple[Observation, ...]
    base_from_flange: Array  # (views, 4, 4), in the order of `observations`
    unseen: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)
    eye_to_hand: bool = False  # whether the camera stands beside the arm and the target is on the flange
    joints: Array | None = None  # (views, n) joint angles as reported [rad], where the session holds them
    links: Links = UR5E  # the arm's nominal chain, where it has joint angles
    region: Region | None = None  # of the sensor that every image shows, where the recording states it
    left_out: dict[str, str] = field(default_factory=dict)  # pictures that were not searched, with the reason
    images: dict[str, Path] = field(default_factory=dict)  # by name of the view, where there are any
    readings: tuple[
        Reading, ...
    ] = ()  # other ways to read the numbers of the poses, where they came from a file of another program
    clocked: Clocked | None = None  # the clocks of pictures and poses, where the session came from a ROS bag

    @property
    def stand_from_mount(self) -> Array:
        """(views, 4, 4) base_from_flange, or its inverse with the camera beside the arm; see `calib.handeye.model`."""
        return pose.inverse(self.base_from_flange) if self.eye_to_hand else self.base_from_flange

    def at_exposure(self, latency_s: float) -> Self:
        """The same with the poses at the exposures if the stamps are late by so much [s]; halts do not depend on it."""
        clocked = self.clocked
        if clocked is None or clocked.halts:
            return self
        return replace(self, base_from_flange=clocked.track.at(clocked.track.seconds(clocked.stamps_ns) - latency_s))

    def chosen(self, keep: Mask) -> Self:
        """The same with the views of `keep` (views,) alone."""
        return self.with_observations([o for o, kept in zip(self.observations, keep, strict=True) if kept])

    def with_observations(self, observations: Sequence[Observation]) -> Self:
        """The same with `observations` instead, which may lack corners and views."""
        names = [o.name for o in self.observations]
        rows = [names.index(o.name) for o in observations]
        joints = None if self.joints is None else self.joints[rows]
        readings = tuple(replace(one, base_from_flange=one.base_from_flange[rows]) for one in self.readings)
        chosen = {"observations": tuple(observations), "base_from_flange": self.base_from_flange[rows]}
        clocked = None if self.clocked is None else self.clocked.chosen(rows)
        return replace(self, **chosen, joints=joints, readings=readings, clocked=clocked)


def grey(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """(height, width) brightness of a (height, width, 1 to 4) picture: Rec. 601 weights on sRGB values, alpha left out."""
    if picture.shape[-1] < 3:
        return picture[..., 0]
    return picture[..., :3] @ np.array([0.299, 0.587, 0.114], np.float32)


def observe(
    board: Board,
    views: Sequence[tuple[str, Path, Array]],
    *,
    provenance: dict[str, Any] | None = None,
    seen: Callable[[str], None] = lambda words: None,
    eye_to_hand: bool = False,
) -> TargetSession:
    """Find the target in `views`: (name, image, (4, 4) base_from_flange) each. `seen` is called after each with a few words.

    Raises:
        TargetError: no view shows the target, or the images differ in size.
        DatasetError: an image cannot be read.
    """
    size, observations, poses, unseen = None, [], [], []
    for name, image, base_from_flange in views:
        picture = grey(images.read(image))
        size = size or picture.shape
        if picture.shape != size:
            why = f"{picture.shape[1]}x{picture.shape[0]}, not {size[1]}x{size[0]}"
            remedy = "record a session with one camera setting"
            raise TargetError("image has another size than the first", where=image, why=why, remedy=remedy)
        observation = detect(board, picture, name)
        if observation is None:
            unseen.append(name)
        else:
            observations.append(observation)
            poses.append(base_from_flange)
        seen(f"view {name}: {0 if observation is None else len(observation.ids)} corners")
    if board.kind == "chessboard" and len(observations) < inner_corners.NEARLY_NONE * len(views):
        without = [image for name, image, _ in views if name in unseen]
        some = without[:: -(-len(without) // inner_corners.TRIED)]
        inner_corners.explain(board, (grey(images.read(image)) for image in some))
    if size is None or not observations:
        why, counted = f"{len(views)} views searched for {describe(board)}", " (squares, not inner corners)" * board.is_checkered
        remedy = f"check the board's description{counted} and the exposure"
        raise TargetError("calibration target is not in any view", why=why, remedy=remedy)
    found = TargetSession(board, size[1], size[0], tuple(observations), np.stack(poses), tuple(unseen), provenance or {})
    return replace(found, eye_to_hand=eye_to_hand, images={name: image for name, image, _ in views})


def observe_recording(
    path: Path, board: Board | None = None, *, seen: Callable[[str], None] = lambda words: None
) -> TargetSession:
    """Find the target of a recording in its frames, or another `board`. Nothing under its truth folder is read."""
    recording = Recording.open(path)
    if board is None and recording.is_of_a_bag:
        where, remedy = recording.part(BAG).get("path"), "give it as --board, to 'calib handeye' first"
        raise TargetError("a bag does not say which target it shows", where=where, remedy=remedy)
    board = board or read_board(recording.manifest.get("board"), where=f"{Path(path) / MANIFEST}, board")
    frames = [frame for frame in recording.frames if frame.split != MOVING]
    views = [(f.name, recording.image_path(f), f.base_from_flange) for f in frames]  # paths are checked on opening
    if not views:
        raise TargetError("recording holds no frames", where=path, remedy="finish it with 'capture run --resume'")
    beside = recording.manifest.get("eye_to_hand") is True
    session = observe(board, views, provenance=provenance_of(path, board), seen=seen, eye_to_hand=beside)
    if (track := recording.track) is not None:
        return replace(session, clocked=_clocked(recording, track, board, session, seen))
    joints = {frame.name: frame.joints for frame in frames}
    region = Region.of_recording(recording.manifest, where=recording.path / MANIFEST)
    angles = np.stack([joints[o.name] for o in session.observations])
    return replace(session, region=region, joints=angles, links=recording.links)


def _clocked(recording: Recording, track: Track, board: Board, session: TargetSession, seen: Callable[[str], None]) -> Clocked:
    """The clocks of a recording that was made of a ROS bag, and the target in the pictures of its moving arm."""
    found, stamps = [], {frame.name: frame.host_time_ns for frame in recording.frames}
    for frame in recording.frames:
        if frame.split == MOVING:
            observation = detect(board, grey(images.read(recording.image_path(frame))), frame.name)
            found += [] if observation is None else [observation]
            seen(f"moving {frame.name}: {0 if observation is None else len(observation.ids)} corners")
    own, moving = (np.array([stamps[o.name] for o in some], np.int64) for some in (session.observations, found))
    return Clocked(track, own, tuple(found), moving, recording.part(BAG).get("halts") is True)


def provenance_of(path: Path, board: Board) -> dict[str, Any]:
    """Where the measurements of a recording come from, for the calibration file."""
    bag = files.read_json(Path(path) / MANIFEST).get(BAG) or {}
    return {
        "recording": bag.get("path") or str(Path(path).resolve()),
        **({"bag": {key: bag.get(key) for key in ("base", "flange", "topic", "notes", "camera_info")}} if bag else {}),
        "frames_sha256": files.sha256(Path(path) / FRAMES),
        "board": board.to_json(),
        "software": {"koala-capture": version("koala-capture"), "opencv": version("opencv-contrib-python-headless")},
    }


def describe(board: Board) -> str:
    """A few words on a board."""
    return f"a {board.squares_x}x{board.squares_y} {board.kind} board with squares of {1e3 * board.square_length_m:g} mm"
