"""The size of a model in metres: by printed markers, by a known length, or by positions that an arm measured.

Structure from motion finds everything but the size.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError, nearest
from koala3d.datasets.process.pictures.markers import PlacedMarker
from koala3d.datasets.process.world import similarity
from koala3d.datasets.process.world.similarity import Similarity
from koala3d.datasets.scene import View
from koala3d.datasets.structure.triangulate import meeting_point

Array = NDArray[np.float64]

FEWEST_POSITIONS = 4
"""Smallest number of known positions: three fix a similarity, the fourth shows a mistake."""
ENOUGH_FOR_OFFSET = 8
"""Smallest number of known positions, 24 numbers, from which an offset is solved for: ten unknowns."""
DOUBTFUL = 0.02
"""Positions that are off by more than this share of their spread are refused."""
MAX_BYTES = 2**24


@dataclass(frozen=True)
class KnownLength:
    """Two points, each seen in two pictures or more, and their distance."""

    ends: tuple[dict[str, tuple[float, float]], dict[str, tuple[float, float]]]
    """Pixel of each end by the name of the view."""
    length_m: float

    @classmethod
    def parse(cls, first: str, second: str, length_m: float) -> "KnownLength":
        """From words such as "IMG_1:812,400+IMG_7:790,420". Raises UsageError where they are not of this form."""
        if not (np.isfinite(length_m) and length_m > 0):
            raise UsageError("a known length must be positive", where="--known-length", why=f"{length_m} m")
        return cls((_parsed(first), _parsed(second)), length_m)


def by_markers(placed: Sequence[PlacedMarker], side_m: float) -> tuple[float, str]:
    """Metres per unit, and the evidence, from markers whose printed side is `side_m`. Raises UsageError where there is none."""
    if not placed:
        why = "no printed marker was found that three pictures agree on"
        remedy = "show the marker larger and from more sides, or leave --marker-mm out"
        raise UsageError("scale cannot be taken from a marker", where="--marker-mm", why=why, remedy=remedy)
    sides = np.array([marker.side for marker in placed])
    factors = side_m / sides
    middle = float(np.median(factors))
    words = (
        f"{len(placed)} markers, whose sides agree to {100 * np.ptp(factors) / middle:.1f}%" if len(placed) > 1 else "a marker"
    )
    return middle, f"{words} ({placed[0].kind} in {placed[0].seen} pictures)"


def by_length(views: Sequence[View], known: KnownLength) -> tuple[float, str]:
    """Metres per unit, and the evidence. Raises UsageError where a picture is not in the scene or an end cannot be placed."""
    named = {view.name: view for view in views}
    ends = []
    for end in known.ends:
        for name in end:
            if name not in named:
                remedy = nearest(name, named) if len(named) < 20 else "check the name"
                raise UsageError(f"no picture called {name!r} was placed", where="--known-length", remedy=remedy)
        place = meeting_point([(named[name], pixel) for name, pixel in end.items()])
        if place is None:
            why = f"{' and '.join(end)} look at it from the same direction"
            raise UsageError("an end has no depth", where="--known-length", why=why, remedy="choose pictures further apart")
        ends.append(place)
    distance = float(np.linalg.norm(ends[0] - ends[1]))
    if distance <= 0:
        raise UsageError("both ends are the same point", where="--known-length")
    return known.length_m / distance, f"a known length of {known.length_m:g} m"


def read_positions(path: Path) -> dict[str, Array]:
    """Positions [m] by name, from lines "NAME X Y Z"; lines that begin with # are left out.

    Between the words are semicolons, tabs, spaces or commas, and commas in the numbers if something else is between them.

    Raises:
        UsageError: the file is missing.
        DatasetError: a line is of another form, or a name is listed twice.
    """
    found: dict[str, Array] = {}
    lines = files.read_text(path, MAX_BYTES, suffixes=(".txt", ".csv")).splitlines()
    for number, line in enumerate(lines, 1):
        words = _words(line)
        if not words or words[0].startswith("#"):
            continue
        where = f"{path}, line {number}"
        try:
            position = np.array([float(word.replace(",", ".")) for word in words[-3:]])
        except ValueError:
            position = np.array([np.nan])
        if len(words) < 4 or not np.isfinite(position).all():
            raise DatasetError("is not a name and three numbers", where=where, why=repr(line[:60]), remedy="write NAME X Y Z")
        name = " ".join(words[:-3])
        if name in found:
            raise DatasetError("picture is listed twice", where=where, why=name)
        found[name] = position
    return found


def _words(line: str) -> list[str]:
    """The words of a line; commas stay in them if something else is between four of them or more."""
    for mark in (";", "\t"):
        if line.count(mark) >= 3:
            return [word.strip() for word in line.split(mark) if word.strip()]
    words = line.split()
    return words if len(words) >= 4 and not any(word.endswith(",") for word in words) else line.replace(",", " ").split()


def by_positions(views: Sequence[View], positions: Mapping[str, Array]) -> tuple[Similarity, str]:
    """The similarity to the world of measured positions [m], and the evidence.

    Positions are of the camera or of something fixed to it, such as an arm's flange: where an unknown offset from the camera
    explains them much better, it is solved for.

    Raises:
        UsageError: too few views have a position, or the positions do not fit.
    """
    known = [view for view in views if _position(view, positions) is not None]
    if len(known) < FEWEST_POSITIONS:
        why = f"{len(known)} of {len(views)} pictures that were placed, {FEWEST_POSITIONS} are needed"
        raise UsageError("too few pictures have a position", where="--positions", why=why, remedy="list them by file name")
    cameras = np.stack([view.world_from_camera for view in known])
    wanted = np.stack([place for view in known if (place := _position(view, positions)) is not None])
    found, off = similarity.between(cameras[:, :3, 3], wanted), np.zeros(3)
    error = _rms(_predicted(cameras, found, off) - wanted)
    if len(known) >= ENOUGH_FOR_OFFSET:
        with_offset, offset = _with_offset(cameras, wanted, found)
        better = _rms(_predicted(cameras, with_offset, offset) - wanted)
        if better < error / 2:
            found, off, error = with_offset, offset, better
    spread = _rms(wanted - wanted.mean(0))
    if not error <= DOUBTFUL * spread:
        why = f"they are off by {1000 * error:.1f} mm (rms) and {1000 * spread:.0f} mm apart"
        raise UsageError(
            "positions do not fit the pictures", where="--positions", why=why, remedy="check names and unit (metres)"
        )
    beside = f", {1000 * np.linalg.norm(off):.0f} mm beside the camera" if off.any() else ""
    return found, f"{len(known)} positions, off by {1000 * error:.2f} mm (rms){beside}"


def _with_offset(cameras: Array, wanted: Array, start: Similarity) -> tuple[Similarity, Array]:
    """The similarity and the (3,) offset [m] in the cameras' frame that take (n, 4, 4) cameras to (n, 3) positions."""
    from scipy.optimize import least_squares

    def unpacked(x: Array) -> tuple[Similarity, Array]:
        turn = pose.from_rotation_vector(x[1:4])[:3, :3] @ start.rotation
        return Similarity(start.scale * float(np.exp(x[0])), turn, x[4:7]), x[7:]

    def residual(x: Array) -> Array:
        return (_predicted(cameras, *unpacked(x)) - wanted).ravel()

    first = np.concatenate([np.zeros(4), start.translation, np.zeros(3)])
    return unpacked(least_squares(residual, first, x_scale="jac").x)


def _predicted(cameras: Array, found: Similarity, offset: Array) -> Array:
    """(n, 3) where a similarity puts a point that is `offset` [m] from each camera."""
    return found.points(cameras[:, :3, 3]) + cameras[:, :3, :3] @ offset @ found.rotation.T


def _position(view: View, positions: Mapping[str, Array]) -> Array | None:
    """Position of a view, listed by its name or by its file's."""
    for name in (view.name, view.image.name):
        if name in positions:
            return positions[name]
    return None


def _rms(differences: Array) -> float:
    return float(np.sqrt((differences**2).sum(-1).mean()))


def _parsed(words: str) -> dict[str, tuple[float, float]]:
    """Pixels by the name of a view, of one point. Raises UsageError."""
    found = {}
    try:
        for part in words.split("+"):
            name, _, numbers = part.rpartition(":")
            x, y = (float(number) for number in numbers.split(","))
            found[name.strip()] = (x, y)
    except ValueError:
        found = {}
    if len(found) < 2 or "" in found:
        remedy = "write each end as it is in two pictures, PICTURE:X,Y+PICTURE:X,Y"
        raise UsageError("does not name a point", where="--known-length", why=repr(words), remedy=remedy)
    return found
