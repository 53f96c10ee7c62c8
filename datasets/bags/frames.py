"""Coordinate frames of a bag: which is the arm's base, which its flange, and where the flange was over time."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.track import Track

FLANGES = ("flange", "tool0", r"\w*link8", "link_eef", r"\w*link_ee", "ee_link", r"\w*link_7", "wrist_3_link", "link6")
"""Names of flanges, the most exact first: ROS-Industrial's (REP 199), Franka's, xArm's, KUKA's. A prefix may be in front."""
BASES = ("base_link", r"\w*link0", "base", "world")
"""Names of bases of arms: all stand still to each other."""
DAY_NS, LONGEST_DAYS = 24 * 3600 * 10**9, 0.5
"""Poses that span more are on a clock that jumped [days]."""
MOVED_M, MOVED_RAD = 1e-6, 1e-6
"""Transforms that change by no more stand still."""


@dataclass(frozen=True, eq=False)
class Edge:
    """A frame in its parent over time."""

    parent: str
    times_ns: NDArray[np.int64]
    """(n,) ascending."""
    poses: NDArray[np.float64]
    """(n, 4, 4) parent_from_child [m]."""

    @property
    def moves(self) -> bool:
        """Whether the frame ever moves in its parent."""
        shift, turn = pose.difference(self.poses, self.poses[:1])
        return bool(shift.max() > MOVED_M or turn.max() > MOVED_RAD)


Tree = dict[str, Edge]
"""Each frame by its name, but the root."""


def edge_of(parent: str, samples: list[tuple[int, NDArray[np.float64]]]) -> Edge:
    """An edge of (time stamp, (4, 4) pose) pairs in any order; of two at one time the later one counts."""
    ordered = dict(sorted(samples, key=lambda sample: sample[0]))
    return Edge(parent, np.array(list(ordered), np.int64), np.stack(list(ordered.values())))


def ancestors(tree: Tree, name: str) -> list[str]:
    """Frames from `name` up to the root. Raises DatasetError for a circle."""
    found = [name]
    while found[-1] in tree:
        above = tree[found[-1]].parent
        if above in found:
            raise DatasetError("frames form a circle", where="/tf", why=" -> ".join([*found, above]))
        found.append(above)
    return found


def ends(tree: Tree, *, where: object) -> tuple[str, str]:
    """Names of base and flange. Raises UsageError if no frame moves, or the arm cannot be told."""
    moving = {name for name in tree if any(one in tree and tree[one].moves for one in ancestors(tree, name))}
    if not moving:
        why = f"frames are {', '.join(sorted(tree)) or 'none'}"
        remedy = "record /tf and /tf_static, or /joint_states and /robot_description"
        raise UsageError("no frame of an arm moves", where=where, why=why, remedy=remedy)
    flange = _flange(tree, moving, where)
    above = ancestors(tree, flange)
    named = (name for kind in BASES for name in above if re.fullmatch(rf"(?:\w+[_/])?{kind}", name) and name not in moving)
    last = next((name for name in above if name not in moving), above[-1])
    return next(named, last), flange


def _flange(tree: Tree, moving: set[str], where: object) -> str:
    """The frame with the most usual name, else the end of the longest chain of frames that move."""
    for kind in FLANGES:
        found = sorted(name for name in moving if re.fullmatch(rf"(?:\w+[_/])?{kind}", name))
        if len(found) > 1:
            raise UsageError(
                "bag has several arms", where=where, why=f"flanges {', '.join(found)}", remedy="cut it to one arm's /tf"
            )
        if found:
            return found[0]
    own = {name: sum(one in tree and tree[one].moves for one in ancestors(tree, name)) for name in moving if tree[name].moves}
    longest = [name for name, count in own.items() if count == max(own.values())]
    if len(longest) > 1:
        why = f"{', '.join(sorted(longest))} could be it"
        raise UsageError("flange cannot be told", where=where, why=why, remedy="name the flange tool0 or flange in /tf_static")
    return longest[0]


def track_of(tree: Tree, base: str, flange: str, *, where: object) -> Track:
    """base_from_flange at the stamps of the frame between them that is reported most often; the others are interpolated.

    Raises DatasetError if the flange is not below the base, or no poses overlap; UsageError if the clock jumped.
    """
    chain = ancestors(tree, flange)
    if base not in chain:
        raise DatasetError("flange is not below the base", where=where, why=" -> ".join(chain))
    edges = [tree[name] for name in chain[: chain.index(base)]][::-1]
    moving = [edge for edge in edges if len(edge.times_ns) > 1]
    first, last = max(edge.times_ns[0] for edge in moving), min(edge.times_ns[-1] for edge in moving)
    times = max(moving, key=lambda edge: len(edge.times_ns)).times_ns
    times = times[(times >= first) & (times <= last)]
    if len(times) and (days := (int(times[-1]) - int(times[0])) / DAY_NS) > LONGEST_DAYS:
        remedy = "cut the part with one clock out of the bag"
        raise UsageError("clock of the poses jumped", where=where, why=f"they span {days:.3g} days", remedy=remedy)
    if len(times) < 2:
        raise DatasetError("poses of the arm's frames do not overlap in time", where=where, why=" -> ".join(chain))
    poses = np.broadcast_to(np.eye(4), (len(times), 4, 4))
    for edge in edges:
        if len(edge.times_ns) == 1:
            poses = poses @ edge.poses[0]
        else:
            own = Track(edge.times_ns, edge.poses)
            poses = poses @ own.at(own.seconds(times))
    return Track(times, np.ascontiguousarray(poses))
