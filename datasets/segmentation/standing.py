"""Masks of an object that stands on a plane: what the views see past it is carved away, and what is left is cut out.

The two help each other: where the object is, the plane cannot be seen, and where the plane is seen, the object is not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import label

from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.segmentation.backdrop import Backdrop, Flags, Picture, Plane, noise_of, tolerance_of
from koala3d.datasets.segmentation.cut import Drawn, cut
from koala3d.datasets.structure.bounds import grid
from koala3d.datasets.structure.masks.silhouette import Sight, Silhouette
from koala3d.datasets.structure.masks.votes import SHARE, carved

CELLS = 112
"""Cells along the longest side of the object's box."""
TIMES = 2
"""Times that all views are cut."""
ROUNDS = 3
"""Times that the plane is looked at, each time past the object as it was found before."""
SAME, OTHER = 3.0, 8.0
"""In noises: difference up to which a pixel shows the plane, and from which on it certainly shows something else."""
OPENING = 5
"""Width of the pixels that show the plane, at least: a mirror shows its colours here and there [px]."""
EMPTY_BY = 0.04
"""Share of the views that must see the plane through a cell; at least two do."""
BAND = 9
"""Width of the border within which each view is cut anew [px]."""
EXPECTED, POSSIBLE = 0.8, 0.45
"""Expectation of pixels on the silhouette of what is left, and next to it; see `cut`."""
NEAR = 5
"""Width of the square in which a border's pixel is compared with those behind it [px]."""
LARGE = 0.03
"""Share of a picture from which on pixels that show the plane need not be joined with its border."""
LEAST_SEEN, MOST_NOISE = 0.2, 0.025
"""Share of the pixels that must show the plane, and median difference above which views agree on it by chance (sRGB)."""
EXPLAINED, CUT_OFF = 0.5, 0.2
"""Share of what is around the object that must show the plane, and share of the pictures' borders that the object may cover: else
there is no such plane, or too few views see it."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What each view shows of the plane."""

    differences: list[Picture]
    """(height, width) by how much each pixel differs from the plane behind it; infinite if that is not known."""
    noise: float
    """Median difference."""

    @cached_property
    def plane(self) -> list[Flags]:
        """(height, width) pixels that show it, see `_plane_in`."""
        return [_plane_in(one, self.noise) for one in self.differences]


class Standing:
    """The views of an object in a box, of which one face lies on the plane."""

    def __init__(self, box: ArrayLike, pictures: Sequence[NDArray[np.uint8]], sights: Sequence[Sight]) -> None:
        """Of small (height, width, 3) pictures."""
        self.box, self.pictures, self.sights = np.asarray(box, np.float64), pictures, sights
        sides = np.ptp(self.box, axis=0)
        self.cells = np.maximum(np.ceil(sides / sides.max() * CELLS / 4).astype(int), 1) * 4
        self.radius = float((sides / self.cells).max()) / 2
        self.backdrop = Backdrop(Plane.behind(self.box, sights), pictures, sights)
        self.seen = self._look()
        """None if the views agree on no plane."""

    def _look(self) -> "Seen | None":
        """At the plane, past the object as it was found before, `ROUNDS` times."""
        differences = self.backdrop.differences()
        for _ in range(ROUNDS):
            seen = Seen(differences, noise_of(differences))
            if seen.noise > MOST_NOISE or np.mean([one.mean() for one in seen.plane]) < LEAST_SEEN:
                return None
            hidden = []
            for outline, one in zip(self._outlines([~one for one in seen.plane], EMPTY_BY), differences, strict=True):
                hidden.append(_inner(outline) | (outline & np.isfinite(one) & (one > OTHER * seen.noise)))
            differences = self.backdrop.differences(hidden, tolerance_of(seen.noise))
        return Seen(differences, noise_of(differences))

    def masks(self, seen: "Seen", drawn: Sequence[Drawn], *, done: Step = ignore) -> list[Flags] | None:
        """(height, width) pixels of the object in each view; None if the plane explains too little.

        Args:
            seen: what the views show of the plane.
            drawn: what strokes say of each view: it is kept, and what strokes of the background cross is not the object's.
            done: called after each view of the `TIMES` times that all are cut.
        """
        found = [~one for one in seen.plane]
        for share in EMPTY_BY, SHARE:
            found = self._cut(self._outlines(found, share, drawn), seen, drawn, done)
        around = sum((~mask).sum() for mask in found)
        explained = sum((~mask & (one < SAME * seen.noise)).sum() for mask, one in zip(found, seen.differences, strict=True))
        cut_off = np.mean([np.concatenate([one[0], one[-1], one[:, 0], one[:, -1]]).mean() for one in found])
        return found if explained > EXPLAINED * around and cut_off < CUT_OFF else None

    def hints(self, seen: "Seen", drawn: Sequence[Drawn]) -> list[Drawn]:
        """What strokes say, and what certainly shows the plane or something in front of it: for a cut by colours."""
        found = []
        for outline, difference, plane, strokes in zip(
            self._outlines([~one for one in seen.plane], EMPTY_BY), seen.differences, seen.plane, drawn, strict=True
        ):
            other = outline & np.isfinite(difference) & (difference > OTHER * seen.noise)
            found.append(Drawn((other & ~strokes.background) | strokes.object, (plane & ~strokes.object) | strokes.background))
        return found

    def _outlines(self, room: Sequence[Flags], share: float, drawn: Sequence[Drawn] = ()) -> list[Flags]:
        """(height, width) silhouettes of the largest connected part of what views leave room for."""
        shown = [Silhouette(sight.camera, sight.world_from_camera, one) for sight, one in zip(self.sights, room, strict=True)]
        points = grid(self.box, self.cells)
        left = np.zeros(len(points), bool)
        left[carved(shown, self.box, self.cells, seen_by=max(len(shown) // 6, 1), share=share, centres=True)] = True
        for sight, strokes in zip(self.sights, drawn, strict=False):
            if strokes.background.any():
                painted = Silhouette(sight.camera, sight.world_from_camera, ~strokes.background)
                left &= ~painted.votes(points.T, 0.0)[1]
        parts, count = label(left.reshape(self.cells))
        if count > 1:
            left = parts.ravel() == 1 + np.bincount(parts.ravel())[1:].argmax()
        return [_inner(sight.covered(points[left], self.radius)[0], 3) for sight in self.sights]

    def _cut(self, outlines: Sequence[Flags], seen: "Seen", drawn: Sequence[Drawn], done: Step) -> list[Flags]:
        """Each view along its outline, by where the plane is seen, elsewhere by its colours."""
        found = []
        for view, (outline, strokes) in enumerate(zip(outlines, drawn, strict=True)):
            difference, core, wide = (
                seen.differences[view],
                _inner(outline),
                cv2.dilate(outline.astype(np.uint8), _disc(BAND)) > 0,
            )
            known, same = np.isfinite(difference), difference < SAME * seen.noise
            other = known & ((wide & (difference > OTHER * seen.noise)) | (outline & ~same))
            other |= core & self.backdrop.shown[view][1] & ~known  # no view sees the plane there
            clear = ~other & (seen.plane[view] | (same & ~core))
            certain = Drawn((other | strokes.object) & ~strokes.background, (clear & ~strokes.object) | strokes.background)
            expected = np.select([outline, wide], [EXPECTED, POSSIBLE], 0.0).astype(np.float32)
            mask = _trimmed(_largest(cut(self.pictures[view], expected, certain)), difference)
            found.append((mask & ~strokes.background) | strokes.object)
            done()
        return found


def _plane_in(difference: Picture, noise: float) -> Flags:
    """Pixels that show the plane and are joined with the picture's border by others that do, or with many."""
    same = cv2.morphologyEx((difference < SAME * noise).astype(np.uint8), cv2.MORPH_OPEN, np.ones((OPENING, OPENING), np.uint8))
    _, parts, figures, _ = cv2.connectedComponentsWithStats(same)
    counts = figures[:, cv2.CC_STAT_AREA] > LARGE * same.size
    counts[np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]])] = True
    return np.asarray(counts[parts] & (parts > 0))


def _trimmed(mask: Flags, difference: Picture) -> Flags:
    """The mask, smooth, without pixels of its border that show more of the plane than of the object.

    A pixel that the object half covers differs from the plane half as much as the ones behind it."""
    inner = mask & np.isfinite(difference) & (cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0)
    values = np.where(inner, difference, 0).astype(np.float32)
    near = cv2.blur(values, (NEAR, NEAR)) / np.maximum(cv2.blur(inner.astype(np.float32), (NEAR, NEAR)), 1e-6)
    kept = mask & (inner | ~np.isfinite(difference) | (difference > near / 2))
    return np.asarray(cv2.medianBlur(kept.astype(np.uint8), 3) > 0)


def _inner(outline: Flags, width: int = BAND) -> Flags:
    """The outline less a border; the picture's own border is none."""
    return np.asarray(cv2.erode(outline.astype(np.uint8), _disc(width), borderValue=1) > 0)


def _disc(width: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width)), np.uint8)


def _largest(mask: Flags) -> Flags:
    """The largest connected part."""
    count, parts, figures, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return mask if count < 2 else np.asarray(parts == 1 + figures[1:, cv2.CC_STAT_AREA].argmax())
