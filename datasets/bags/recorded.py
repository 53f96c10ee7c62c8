"""A ROS bag as a recording, so that everything that reads recordings reads bags.

The recording is made once and kept in Koala's cache, for as long as the files of the bag stay the same. It holds what is used of
the bag: the chosen pictures, the path of the flange, and in the manifest what was found. Poses are those at the pictures' time
stamps; a latency is measured by `calib handeye` and applied by `datasets build`.
"""

import hashlib
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.bags import choosing, pictures, reading, urdf
from koala3d.datasets.bags.frames import Tree, edge_of, ends, track_of
from koala3d.datasets.bags.reading import Bag
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.core.progress import Count, ignore
from koala3d.datasets.kinematics import UR5E
from koala3d.datasets.recording import BAG, IMAGES, MOVING, Frame, Recording
from koala3d.datasets.track import FILE, Track

REVISION = 1
"""Of what this module makes: recordings of earlier ones are made again."""
HELD_OUT = 8
"""Every so many views, the first included, one is a test view."""
LEAST_VIEWS = 3
FURTHEST, LEAST_NORM = 1e9, 0.5
"""Larger numbers are no poses [m], nor are quaternions that are shorter."""
DESCRIPTION = "robot_description"
"""How the topic of an arm's URDF ends."""


def recording_of(path: Path, done: Count = ignore) -> Path:
    """The folder of the recording of a bag, made where it is not in the cache; any other path as it is.

    `done` is called with the number of messages read and their total.

    Raises:
        UsageError: the bag lacks pictures or poses, or has several cameras or arms.
        DatasetError: it is damaged.
    """
    path = Path(path)
    if not reading.is_bag(path):
        return path
    folder = files.cache_folder() / "bags" / _key(path)
    if not (folder / "manifest.json").is_file():
        with files.atomic_folder(folder) as temporary:
            _write(path, temporary, done)
    return folder


def _key(path: Path) -> str:
    """Name of the recording in the cache: where the bag is, and sizes and times of its files."""
    stated = [(one.name, one.stat().st_size, one.stat().st_mtime_ns) for one in reading.files_of(path)]
    return hashlib.sha256(repr((REVISION, str(path.resolve()), stated)).encode()).hexdigest()[:24]


@dataclass(frozen=True)
class _Found:
    """What a bag holds beside its pictures."""

    topic: str
    stamps_ns: np.ndarray
    """(n,) time stamps of the pictures in the order of their arrival."""
    tree: Tree
    poses_from: str
    info: pictures.CameraInfo | None
    notes: list[str]


def _write(path: Path, folder: Path, done: Count) -> None:
    """Make the recording of a bag in a new folder."""
    with reading.opened(path) as bag:
        found = _scanned(bag, done)
        base, flange = ends(found.tree, where=path)
        track = track_of(found.tree, base, flange, where=path)
        order = np.argsort(found.stamps_ns, kind="stable")
        stamps = found.stamps_ns[order]
        chosen = choosing.choose(track, stamps)
        if len(chosen.views) < LEAST_VIEWS:
            first, last = (datetime.fromtimestamp(1e-9 * t, UTC).isoformat() for t in (stamps[0], stamps[-1]))
            why = f"{len(chosen.unposed)} of {len(stamps)} pictures ({first} to {last}) have no pose"
            remedy = "record pictures and poses at the same time, on clocks that agree"
            raise UsageError("too few pictures have a pose", where=path, why=why, remedy=remedy)
        content = _manifest(path, found, stamps, track, chosen) | {"base": base, "flange": flange}
        recording = Recording.create(folder, {"trajectory": {}, BAG: content})
        track.save(folder / FILE)
        for frame in _frames(bag, found, order, track, chosen, folder):
            recording.append(frame)


def _scanned(bag: Bag, done: Count) -> _Found:
    """All stamps, poses and descriptions of a bag, in one pass."""
    images = _image_topic(bag)
    above = images.removesuffix("/compressed").rpartition("/")[0]
    tf, joints = bag.topics(*reading.TRANSFORMS), bag.topics(reading.JOINTS)
    texts = [topic for topic in bag.topics(reading.TEXT) if topic.endswith(DESCRIPTION)]
    infos = [topic for topic in bag.topics(reading.CAMERA_INFO) if topic.rpartition("/")[0] == above]
    stamps, unstamped, info, text, states, senseless = [], 0, None, "", [], Counter[str]()
    samples: dict[str, tuple[str, list[tuple[int, np.ndarray]]]] = {}
    wanted = [images, *tf, *joints, *texts, *infos]
    total = sum(count for topic, count in bag.topics(*_TYPES).items() if topic in wanted)
    for count, message in enumerate(bag.messages(wanted), 1):
        done(count, total)
        if message.topic == images:
            stamps.append(message.stamp_ns)
            unstamped += not message.stamped
        elif message.topic in tf:
            for one in message.content.transforms:
                child, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
                if (matrix := _pose(one.transform)) is None:
                    senseless[child] += 1
                else:
                    when = reading.stamp_ns(one.header) or message.stamp_ns
                    samples.setdefault(child, (parent, []))[1].append((when, matrix))
        elif message.topic in joints:
            states.append((message.stamp_ns, message.content))
        elif message.topic in texts:
            text = message.content.data
        else:
            info = pictures.CameraInfo.of(message.content)
    notes = [f"{unstamped} pictures have no time stamp: the time of their arrival is taken"] if unstamped else []
    notes += [f"{count} transforms of {name} are no poses and are left out, as tf2 does" for name, count in senseless.items()]
    tree: Tree = {child: edge_of(parent, poses) for child, (parent, poses) in samples.items()}
    if any(edge.moves for edge in tree.values()):
        return _Found(images, np.array(stamps, np.int64), tree, "tf", info, notes)
    return _Found(images, np.array(stamps, np.int64), _by_joints(bag, text, states, tree), "joint_states", info, notes)


_TYPES = (*reading.TRANSFORMS, reading.IMAGE, reading.COMPRESSED, reading.CAMERA_INFO, reading.JOINTS, reading.TEXT)


def _pose(transform: Any) -> np.ndarray | None:
    """(4, 4) of a transform; None where a number is not finite or the quaternion is zero."""
    q, t = transform.rotation, transform.translation
    numbers = np.array([q.w, q.x, q.y, q.z, t.x, t.y, t.z], np.float64)
    if not (np.abs(numbers) < FURTHEST).all() or np.linalg.norm(numbers[:4]) < LEAST_NORM:
        return None
    return np.array(pose.from_quaternion(numbers[:4], numbers[4:]))


def _by_joints(bag: Bag, text: str, states: list[tuple[int, Any]], tree: Tree) -> Tree:
    """Frames by joint angles and the URDF of the bag or beside it; `tree` where there are neither."""
    home = bag.path if bag.path.is_dir() else bag.path.parent
    beside = sorted(home.glob("*.urdf"))
    if not states or not (text or beside):
        return tree
    if not text and len(beside) > 1:
        why = ", ".join(path.name for path in beside)
        raise UsageError("several URDF files are beside the bag", where=home, why=why, remedy="leave the arm's")
    where = bag.path if text else beside[0]
    return {**tree, **urdf.tree_of(text or files.read_text(beside[0], 2**24), states, where=where)}


def _image_topic(bag: Bag) -> str:
    """The topic of the camera's pictures. Raises UsageError if there is none, or there are several."""
    raw = [topic for topic in bag.topics(reading.IMAGE) if "depth" not in topic.lower()]
    small = [topic for topic in bag.topics(reading.COMPRESSED) if "depth" not in topic.lower()]
    found = sorted({*raw, *(topic for topic in small if topic.removesuffix("/compressed") not in raw)})
    if not found:
        remedy = "record the camera's image topic and its camera_info"
        raise UsageError("bag holds no pictures", where=bag.path, remedy=remedy)
    if len(found) > 1:
        remedy = f"copy one camera's: rosbags-convert --src {bag.path} --dst ONE --exclude-topic {found[-1]}"
        raise UsageError("bag holds pictures of several cameras", where=bag.path, why=", ".join(found), remedy=remedy)
    return found[0]


def _manifest(path: Path, found: _Found, stamps: np.ndarray, track: Track, chosen: choosing.Chosen) -> dict[str, Any]:
    """What the manifest says of the bag."""
    notes = list(found.notes)
    start = stamps[0]
    for index, count in choosing.dropped(stamps):
        notes.append(f"{count} pictures are missing after {1e-9 * (stamps[index] - start):.3f} s")
    if chosen.unposed:
        moments = ", ".join(f"{1e-9 * (stamps[index] - start):.3f}" for index in chosen.unposed[:5])
        more = ", ..." if len(chosen.unposed) > 5 else ""
        notes.append(
            f"{len(chosen.unposed)} of {len(stamps)} pictures have no pose of the arm and are not used: at {moments}{more} s"
        )
    info = {} if found.info is None else {"camera_info": vars(found.info)}
    facts = {"path": str(path.resolve()), "topic": found.topic, "poses_from": found.poses_from, "halts": chosen.halts}
    return {**facts, "pictures": len(stamps), "poses": len(track.times_ns), "notes": notes, **info}


def _frames(bag: Bag, found: _Found, order: np.ndarray, track: Track, chosen: choosing.Chosen, folder: Path) -> list[Frame]:
    """Write the chosen pictures: the sharpest candidate of each view, then those of the motion between halts."""
    wanted = {int(order[one]): (f"{view:03d}", view) for view, group in enumerate(chosen.views) for one in group}
    wanted |= {int(order[one]): (f"m{number:03d}", number) for number, one in enumerate(chosen.moving)}
    several = any(len(group) > 1 for group in chosen.views)
    best: dict[str, tuple[float, Frame]] = {}
    sizes: set[tuple[int, int]] = set()
    for number, message in enumerate(bag.messages([found.topic])):
        if number not in wanted:
            continue
        (name, index), where = wanted[number], f"{bag.path}, picture {number} of {found.topic}"
        sharp = pictures.sharpness(message.content, where=where) if several else 0.0
        if name in best and sharp <= best[name][0]:
            continue
        image, size = pictures.write(message.content, folder / IMAGES, name, where=where)
        sizes.add(size)
        split = MOVING if name.startswith("m") else "test" if index % HELD_OUT == 0 else "train"
        best[name] = sharp, _frame(message, index, name, split, image, track, files.sha256(folder / image))
    if len(sizes) > 1:
        why = ", ".join(f"{width}x{height}" for width, height in sorted(sizes))
        raise DatasetError("pictures differ in size", where=bag.path, why=why, remedy="record with one setting of the camera")
    return [best[name][1] for name in sorted(best)]


def _frame(message: reading.Message, index: int, name: str, split: str, image: str, track: Track, sha256: str) -> Frame:
    """A picture as a frame of a recording, with the pose at its time stamp. Joint angles and exposure are not known: zero."""
    return Frame(
        index=index,
        name=name,
        split=split,
        image=image,
        base_from_flange=track.at(track.seconds([message.stamp_ns]))[0],
        joints=np.zeros(UR5E.count),
        robot_time_s=1e-9 * message.stamp_ns,
        host_time_ns=message.stamp_ns,
        device_ticks=message.stamp_ns,
        exposure_us=0.0,
        settle_s=0.0,
        sha256=sha256,
    )
