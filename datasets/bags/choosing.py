"""Which pictures of a bag are used: one of each halt of the arm, or of an arm that never halts as many evenly along its way."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.track import Track

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

STEP_S, WINDOW_S = 0.02, 0.2
"""Rest is looked for in these steps; the arm rests if it is in one place at both ends of a window around a moment [s]."""
REST_M, REST_RAD = 3e-4, float(np.deg2rad(0.03))
"""How far reports of a resting arm differ: ten times the noise of good ones. An arm that moves by 1.5 mm/s goes further."""
SHORTEST_S = 0.4
"""Shorter halts are none: their pictures could be of the motion before, by their latency."""
ALIKE_M, ALIKE_RAD = 0.005, float(np.deg2rad(1))
"""Halts that are nearer to each other are one."""
FEWEST_HALTS = 5
"""With fewer halts that have a picture, the arm is taken to move all the time."""
MOST_VIEWS, CANDIDATES = 120, 5
"""Pictures of an arm that never halts; of so many around each place the sharpest is taken."""
METRES_PER_RADIAN = 0.4
"""A turn by a radian counts as much as so many metres: the usual distance of what is looked at."""
MOST_MOVING = 60
"""Pictures of the motion between halts by which the latency is measured."""
LONGEST_GAP_S = 0.25
"""Between poses further apart in time the arm's way is not known, unless it rests."""
REGULAR, LATE = 0.25, 1.5
"""Intervals within this share of the usual one are regular; one that is this many times as long lacks a picture."""


@dataclass(frozen=True)
class Chosen:
    """Pictures that are used, by their number in the order of time."""

    views: list[list[int]]
    """Candidates of each view, of which the sharpest is taken."""
    moving: list[int]
    """Pictures of a moving arm between halts; none if the arm never halts: then all views are of a moving one."""
    halts: bool
    unposed: list[int]
    """Pictures without a pose."""


def choose(track: Track, stamps_ns: Indices) -> Chosen:
    """Pictures by their (n,) ascending time stamps [ns] on the clock of the poses."""
    seconds = track.seconds(stamps_ns)
    rest, span = resting(track), track.seconds(track.times_ns[-1:])[0]
    gap = track.gap(seconds)
    at_rest = np.array([any(first <= t <= last for first, last in rest) for t in seconds], bool)
    posed = (seconds >= 0) & (seconds <= span) & ((gap <= LONGEST_GAP_S) | at_rest)
    unposed = np.flatnonzero(~posed).tolist()
    halts = _of_halts(track, rest, seconds, posed)
    if len(halts) < FEWEST_HALTS:
        return Chosen(_along_the_way(track, seconds, np.flatnonzero(posed)), [], False, unposed)
    return Chosen([[one] for one in halts], _between(track, seconds, posed & ~at_rest), True, unposed)


def resting(track: Track) -> list[tuple[float, float]]:
    """First and last moment of each halt [s since the first pose]."""
    end = float(track.seconds(track.times_ns[-1:])[0])
    moments = np.arange(0.0, end + STEP_S, STEP_S)
    shift, turn = pose.difference(track.at(moments - WINDOW_S / 2), track.at(moments + WINDOW_S / 2))
    still = np.concatenate([[False], (shift < REST_M) & (turn < REST_RAD), [False]])
    edges = np.flatnonzero(still[1:] != still[:-1]).reshape(-1, 2)
    spans = [(moments[first], moments[last - 1]) for first, last in edges]
    return [(float(first), float(last)) for first, last in spans if last - first >= SHORTEST_S - WINDOW_S]


def _of_halts(track: Track, rest: list[tuple[float, float]], seconds: Array, posed: NDArray[np.bool_]) -> list[int]:
    """The picture nearest to the middle of each halt at a new place."""
    found: list[int] = []
    for first, last in rest:
        inside = np.flatnonzero(posed & (seconds >= first) & (seconds <= last))
        if not len(inside):
            continue
        best = int(inside[np.abs(seconds[inside] - (first + last) / 2).argmin()])
        if found:
            shift, turn = pose.difference(track.at(seconds[found]), track.at(seconds[[best]]))
            if ((shift < ALIKE_M) & (turn < ALIKE_RAD)).any():
                continue
        found.append(best)
    return found


def _between(track: Track, seconds: Array, moving: NDArray[np.bool_]) -> list[int]:
    """Pictures of the motion, evenly in time, of its faster half: slow ones say little of the latency."""
    found = np.flatnonzero(moving)
    if not len(found):
        return []
    speed = _speed(track, seconds[found])
    fast = found[speed >= np.median(speed)]
    return np.unique(fast[np.linspace(0, len(fast) - 1, min(MOST_MOVING, len(fast))).round().astype(int)]).tolist()


def _along_the_way(track: Track, seconds: Array, posed: Indices) -> list[list[int]]:
    """For each of equal parts of the way, the pictures nearest to its middle; all pictures where they are few."""
    if len(posed) <= MOST_VIEWS:
        return [[int(one)] for one in posed]
    moments = np.concatenate([[0.0], seconds[posed]])
    grid = np.arange(0.0, moments[-1] + STEP_S, STEP_S)
    way = np.interp(moments[1:], grid, np.cumsum(_speed(track, grid)) * STEP_S)
    parts = MOST_VIEWS
    place = (way - way[0]) / max(float(way[-1] - way[0]), 1e-12) * parts
    found = []
    for part in range(parts):
        inside = np.flatnonzero((place >= part) & ((place < part + 1) | (part == parts - 1)))
        nearest = inside[np.abs(place[inside] - part - 0.5).argsort()[:CANDIDATES]]
        if len(nearest):
            found.append(sorted(posed[nearest].tolist()))
    return found


def _speed(track: Track, seconds: Array) -> Array:
    """(n,) speed [m/s], turns counted as ways."""
    twist = track.speed(seconds)
    return np.linalg.norm(twist[:, :3], axis=1) + METRES_PER_RADIAN * np.linalg.norm(twist[:, 3:], axis=1)


def dropped(stamps_ns: Indices) -> list[tuple[int, int]]:
    """(number of the picture, how many are missing after it) of a camera that takes pictures at a regular rate; else none."""
    interval = np.diff(stamps_ns).astype(np.float64)
    usual = float(np.median(interval)) if len(interval) else 0.0
    if usual <= 0 or np.mean(np.abs(interval / usual - 1) < REGULAR) < 0.8:
        return []
    return [(int(one), round(interval[one] / usual) - 1) for one in np.flatnonzero(interval > LATE * usual)]
