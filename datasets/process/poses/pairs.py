"""Which pictures to match with which: all of few, neighbours in a video, those that look alike of many."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.imaging.reduced import READERS
from koala3d.datasets.process.pictures.features import PictureFeatures
from koala3d.datasets.process.poses.looks import likeliest, unit

Pairs = list[tuple[int, int]]

KINDS = ("auto", "all", "neighbours", "alike")
MOST_ALL = 60
"""Up to this many pictures, all pairs are matched."""
NEIGHBOURS = 8
"""Frames after each frame of a video that it is matched with."""
FURTHEST = 64
"""Largest distance in frames at which it is matched besides, at every power of two."""
STRONGEST, SHARED = 300, 5
"""Pictures look alike where so many of their strongest features have at least so many mutual matches (Wu 2013, section 3)."""
LIKELIEST = 150
"""So many others of each picture get that look: those whose vectors are nearest."""
RATIO = 0.8
"""A match must be this much nearer than the second best (Lowe 2004, section 7.1)."""


def choose(features: Sequence[PictureFeatures], kind: str, *, in_order: bool, done: Step = ignore) -> Pairs:
    """Pairs of indices, the first smaller than the second.

    Args:
        features: of all pictures.
        kind: one of `KINDS`. "auto" takes all pairs of up to `MOST_ALL` pictures and those that look alike of more.
        in_order: whether neighbours are matched besides: frames of a video.
        done: called after each picture whose look was compared with the others'.
    """
    count = len(features)
    if kind == "all" or (kind == "auto" and count <= MOST_ALL):
        return list(combinations(range(count), 2))
    chosen = set(neighbours(count)) if in_order or kind == "neighbours" else set()
    if kind != "neighbours":
        chosen |= set(alike(features, done=done))
    return sorted(chosen)


def neighbours(count: int) -> Pairs:
    """Pairs of `count` pictures in a row: with the next `NEIGHBOURS`, and at distances of powers of two up to `FURTHEST`."""
    steps = [*range(1, NEIGHBOURS + 1), *(2**k for k in range(32) if NEIGHBOURS < 2**k <= FURTHEST)]
    return [(i, i + step) for i in range(count) for step in steps if i + step < count]


def alike(features: Sequence[PictureFeatures], *, done: Step = ignore) -> Pairs:
    """Pairs whose strongest features match: a quick look that spares most pairs the full matching."""
    strongest = [unit(found.descriptors[:STRONGEST].astype(np.float32)) for found in features]
    worth: list[list[int]] = [[] for _ in features]
    for i, j in sorted(likeliest(features, LIKELIEST)):
        worth[i].append(j)

    def found(i: int) -> Pairs:
        return [(i, j) for j in worth[i] if _shared(strongest[i], strongest[j]) >= SHARED]

    pairs = []
    for some in streamed(found, range(len(features)), workers=READERS):
        pairs += some
        done()
    return pairs


def _shared(first: np.ndarray, second: np.ndarray) -> int:
    """Number of features of unit length that are each other's best match, clearly better than the second best."""
    if min(len(first), len(second)) < 2:
        return 0
    affinity = first @ second.T
    best = affinity.argmax(1)
    rows = np.arange(len(first))
    nearest = 2 - 2 * affinity[rows, best]
    mutual = affinity.argmax(0)[best] == rows
    affinity[rows, best] = -1.0
    return int((mutual & (nearest < RATIO**2 * (2 - 2 * affinity.max(1)))).sum())
