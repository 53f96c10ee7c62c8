"""Poses and pictures that are listed in different orders, recognised without knowing where the camera is on the arm.

Between two views arm and camera turn by the same angle, whatever the pose of the camera on the arm: A X = X B makes A and B
similar. So two lists in the right order agree in the angle between each two of their views. A board that looks the same after
half a turn has two such angles, and either will do.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError

ALIKE = np.deg2rad(1.0)
"""Angles within this agree: twice what hobby arms and small boards scatter by; of random pairs of views 3 to 5 % do."""
SUSPECT = 0.5
"""A view that agrees with a smaller share of the others may be in the wrong place."""
EXPLAINS = 0.9
"""Share of pairs of views that must agree once a mistake is undone."""
SHIFTS = (1, -1, 2, -2)
FEWEST = 6
"""Views below which nothing is suspected: too few pairs of them."""
Order = NDArray[np.intp]


def explain(
    stand_from_mount: Array, readings: Sequence[Array], names: Sequence[str], listed: Sequence[str] | None = None
) -> None:
    """Raise a CalibrationError that names the view from which on lists are out of step, if that is why views disagree.

    Args:
        readings: (views, 4, 4) camera_from_board, once for each way in which the board may have been read.
        names: of these views.
        listed: names of all pictures that were searched, in order; those of the views are among them. Default: `names`.
    """
    found = recognise(stand_from_mount, readings, names, listed)
    if found:
        raise CalibrationError("pictures and arm poses do not fit together", why=found, remedy="correct the list and run again")


def recognise(
    stand_from_mount: Array, readings: Sequence[Array], names: Sequence[str], listed: Sequence[str] | None = None
) -> str:
    """The mistake in the order of views that explains why some disagree, in words; empty where none does. See `explain`."""
    arm, cameras = angles_between(stand_from_mount), [angles_between(readings[0], other) for other in readings]
    every = np.arange(len(names))
    if len(names) < FEWEST or not (suspects := np.flatnonzero(_agreement_of_views(arm, cameras) < SUSPECT)).size:
        return ""
    best, words = EXPLAINS, ""
    by_characters = _by_characters(names, listed or names)
    for pictures, poses, said in (*by_characters, *_hypotheses(every, suspects, names)):
        chosen = [camera[np.ix_(pictures, pictures)] for camera in cameras]
        share = _agreement_of_views(arm[np.ix_(poses, poses)], chosen).mean()
        if share > best:
            best, words = float(share), said
    return words


def angles_between(poses: Array, others: Array | None = None) -> Array:
    """(views, views) angle of the rotation between each of (views, 4, 4) poses and each of the same or of others [rad]."""
    rotations = poses[:, :3, :3]
    trace = np.einsum("aij,bij->ab", rotations, rotations if others is None else others[:, :3, :3])
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


def _agreement_of_views(arm: Array, cameras: Sequence[Array]) -> Array:
    """(views,) share of the other views to which each turns alike by one of the readings."""
    alike = np.any([np.abs(arm - camera) < ALIKE for camera in cameras], axis=0)
    np.fill_diagonal(alike, True)
    return (alike.sum(1) - 1) / (len(alike) - 1)


def _by_characters(names: Sequence[str], listed: Sequence[str]) -> list[tuple[Order, Order, str]]:
    """The mistake that the poses are in the order of the pictures' names by characters, as `_hypotheses` has it, if possible."""
    place = {name: number for number, name in enumerate(names)}
    pairs = [(place[own], place[given]) for own, given in zip(sorted(listed), listed, strict=True) if {own, given} <= set(place)]
    if sorted(listed) == list(listed) or len(pairs) < FEWEST:
        return []
    pictures, poses = np.array(pairs).T
    return [(pictures, poses, "the poses are in the order of the pictures' names by characters (10 before 2), not by numbers")]


def _hypotheses(every: Order, suspects: Order, names: Sequence[str]) -> Iterator[tuple[Order, Order, str]]:
    """Pictures and the poses that belong to them, by mistake, with the mistake in words; the simplest first."""
    count = len(every)
    yield every, every[::-1], "the poses are in reverse order"
    for shift in SHIFTS:
        for start in range(count - FEWEST // 2 - abs(shift)):
            before = every[:start]
            if shift > 0:  # a pose is missing: each later one belongs to a later picture
                pictures = np.concatenate([before, every[start + shift :]])
                poses = np.concatenate([before, every[start : count - shift]])
            else:
                pictures = np.concatenate([before, every[start : count + shift]])
                poses = np.concatenate([before, every[start - shift :]])
            yield pictures, poses, _shifted(shift, names[start])
    for first, second in combinations(suspects, 2):
        poses = every.copy()
        poses[[first, second]] = second, first
        yield every, poses, f"views {names[first]} and {names[second]} have each other's pose"


def _shifted(shift: int, name: str) -> str:
    place = "after" if shift > 0 else "before"
    number = "one" if abs(shift) == 1 else "two"
    lost = {1: f"the pose of view {name}", 2: f"two poses from view {name} on", -1: "a picture", -2: "two pictures"}[shift]
    missing = f"{lost} may be missing" + ("" if shift > 0 else f" before view {name}")
    return f"from view {name} on, each picture has the pose of the {number} {place} it: {missing}"
