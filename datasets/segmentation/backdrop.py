"""The plane that an object stands on, as views see it past the object: where it is seen, the object is not.

Colours alone tell an object from its surroundings only if they differ, and a mirror has those of its surroundings. But a place of
the plane looks the same in all views that see it, and whatever hides it looks different from each side. So a place has the colour
on which several views agree, and a pixel of another colour shows something in front of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from koala3d.datasets.splits import evenly
from koala3d.datasets.structure.masks.silhouette import Sight

SIDE = 256
"""Places along each side of the plane."""
REACH = 2.2
"""Half the plane's side in the longer side of the object's box on it: far enough to be seen past the object."""
BLUR = 0.8
"""Of pictures, and of their differences, against noise [px]."""
FIRST_TOLERANCE, LEAST_TOLERANCE = 0.03, 0.012
"""Difference of colours that agree, in each channel; before the noise is known, and at least. sRGB, 0 to 1."""
NOISES = 3.0
"""The same in the median difference of what is known."""
FEWEST, SHARES = 4, (0.25, 0.15)
"""Views that agree on a place, at least, and their share of those that may see it: at first, and once the object is known."""
CANDIDATES = 24
"""Views of which one has the colour that most agree on: where an eighth agrees, one place in twenty-five is overlooked."""
PART = 4096
"""Places that are looked at together."""
LIKE, LEAST_OTHERS = 0.05, 500
"""Distance of hues that are alike, and known places around the object that those below it are compared with, at least."""
NOTHING = np.float32(-100)
"""The colour of a place in a view that does not see it: near to none that is seen, and finite."""

Picture = NDArray[np.float32]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Plane:
    """A square about the middle of that face of the object's box which most cameras see behind the object."""

    centre: NDArray[np.float64]
    """(3,) [world unit]."""
    across: NDArray[np.float64]
    """(2, 3) unit vectors along its sides."""
    half: float
    """Half its side [world unit]."""
    foot: NDArray[np.float64]
    """(2,) half sides of the box on it [world unit]."""

    @classmethod
    def behind(cls, box: ArrayLike, sights: Sequence[Sight]) -> "Plane":
        """That of a (2, 3) box."""
        corners = np.asarray(box, np.float64)
        forward = np.mean([sight.world_from_camera[:3, 2] for sight in sights], axis=0)
        axis = int(np.argmax(np.abs(forward)))
        centre, others = corners.mean(0), [other for other in range(3) if other != axis]
        centre[axis] = corners[int(forward[axis] > 0), axis]
        sides = np.ptp(corners, axis=0)[others]
        return cls(centre, np.eye(3)[others], REACH * float(sides.max()), sides / 2)

    @property
    def places(self) -> NDArray[np.float64]:
        """(SIDE * SIDE, 3) [world unit]."""
        along = ((np.arange(SIDE) + 0.5) / SIDE * 2 - 1) * self.half
        first, second = np.meshgrid(along, along, indexing="ij")
        return self.centre + np.stack([first, second], -1).reshape(-1, 2) @ self.across

    @property
    def under(self) -> Flags:
        """(SIDE * SIDE,) which places are below the box."""
        return np.asarray((np.abs((self.places - self.centre) @ self.across.T) <= self.foot).all(1))

    def seen_by(self, sight: Sight) -> tuple[Picture, Flags]:
        """(height, width, 2) places of the plane that a view's pixels show, as indices, and which pixels show any."""
        camera, pose = sight.camera, sight.world_from_camera
        directions = camera.directions(camera.pixel_centres().reshape(-1, 2)) @ pose[:3, :3].T
        normal = np.cross(*self.across)
        towards = directions @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((self.centre - pose[:3, 3]) @ normal) / towards
            met = pose[:3, 3] + t[:, None] * directions - self.centre
            index = (met @ self.across.T / self.half + 1) * (SIDE / 2) - 0.5
            on = (t > 0) & (index > 0).all(1) & (index < SIDE - 1).all(1)
        shape = camera.height, camera.width
        return np.where(on[:, None], index, 0).astype(np.float32).reshape(*shape, 2), on.reshape(shape)


class Backdrop:
    """What all views show of a plane."""

    def __init__(self, plane: Plane, pictures: Sequence[NDArray[np.uint8]], sights: Sequence[Sight]) -> None:
        """Look at each of its places in each of the (height, width, 3) `pictures`."""
        self.pictures = [_blurred(np.float32(picture) / 255) for picture in pictures]
        self.pixels, self.inside, colours = [], [], []
        for picture, sight in zip(self.pictures, sights, strict=True):
            local = (plane.places - sight.world_from_camera[:3, 3]) @ sight.world_from_camera[:3, :3]
            ahead = local[:, 2] > 1e-3 * plane.half
            pixels = sight.camera.project(np.where(ahead[:, None], local, [0.0, 0.0, 1.0]))
            inside = ahead & (pixels > 1).all(1) & (pixels < [sight.camera.width - 1, sight.camera.height - 1]).all(1)
            self.pixels.append(np.where(inside[:, None], pixels, 0).astype(int))
            self.inside.append(inside)
            colours.append(_at(picture, (pixels - 0.5).astype(np.float32).reshape(SIDE, SIDE, 2)).reshape(-1, 3))
        self.colours, self.under = np.stack(colours), plane.under
        self.shown = [plane.seen_by(sight) for sight in sights]

    def differences(self, hidden: Sequence[Flags] | None = None, tolerance: float = FIRST_TOLERANCE) -> list[Picture]:
        """(height, width) of each view: by how much its pixels differ from the plane behind them (mean of the channels, sRGB).

        Infinite where that is not known.

        Args:
            hidden: (height, width) pixels of each view that certainly show the object; None: not known yet.
            tolerance: of colours that agree.
        """
        free = np.stack(self.inside)
        if hidden is not None:
            free &= ~np.stack([one[tuple(at.T[::-1])] for one, at in zip(hidden, self.pixels, strict=True)])
        colour, known = _agreed(self.colours, free, tolerance, SHARES[hidden is not None])
        known = _like_others(colour, known, self.under)
        colour, known = colour.reshape(SIDE, SIDE, 3), known.reshape(SIDE, SIDE).astype(np.float32)
        sharp, smooth = [], []
        for picture, (index, on) in zip(self.pictures, self.shown, strict=True):
            place = index[..., ::-1]  # OpenCV has the column first
            seen = (on & (_at(known, place) > 0.99)).astype(np.float32)
            away = (picture - _at(colour, place)) * seen[..., None]
            for one, to in ((away, sharp), (_blurred(away) / np.maximum(_blurred(seen), 1e-6)[..., None], smooth)):
                to.append(np.where(seen > 0, np.abs(one).mean(-1), np.inf).astype(np.float32))
        share = noise_of(smooth) / max(noise_of(sharp), 1e-6)  # smooth ones are wide where the object begins
        return [np.minimum(one, share * other) for one, other in zip(smooth, sharp, strict=True)]


def noise_of(differences: Sequence[Picture]) -> float:
    """Median difference of pixels behind which the plane is known: most of them show it. Infinite if it is known nowhere."""
    known = np.concatenate([one[np.isfinite(one)] for one in differences])
    return float(np.median(known)) if known.size else float("inf")


def tolerance_of(noise: float) -> float:
    """Difference of colours that agree, at such a noise."""
    return max(LEAST_TOLERANCE, NOISES * noise)


def _blurred(values: Picture) -> Picture:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), BLUR), np.float32)


def _at(values: Picture, index: Picture) -> Picture:
    """Values of a picture at fractional (column, row) indices."""
    return np.asarray(cv2.remap(values, index[..., 0], index[..., 1], cv2.INTER_LINEAR), np.float32)


def _agreed(colours: Picture, free: Flags, tolerance: float, share: float) -> tuple[Picture, Flags]:
    """(n, 3) colours on which most of (views, n, 3) views agree, and whether enough of those do that are `free`, (views, n)."""
    colour, known = np.zeros(colours.shape[1:], np.float32), np.zeros(colours.shape[1], bool)
    for start in range(0, len(known), PART):
        part = slice(start, start + PART)
        may = free[:, part]
        looks = np.where(may, np.moveaxis(colours[:, part], -1, 0), NOTHING)
        most, first = np.zeros(may.shape[1], int), np.zeros(may.shape[1], int)
        for view in evenly(range(len(free)), CANDIDATES):
            count = np.where(may[view], _near(looks, looks[:, view], tolerance).sum(0), 0)
            first = np.where(count > most, view, first)
            most = np.maximum(most, count)
        near = _near(looks, looks[:, first, np.arange(len(most))], tolerance)
        colour[part] = (np.where(near, looks, 0).sum(1) / np.maximum(near.sum(0), 1)).T
        known[part] = most >= np.maximum(FEWEST, share * may.sum(0))
    return colour, known


def _like_others(colour: Picture, known: Flags, under: Flags) -> Flags:
    """(n,) which (n, 3) colours are known, less those under the box whose hue no place around it has.

    Views agree on those too, but they show a flat part of the object that lies on the plane."""
    around = known & ~under
    if around.sum() < LEAST_OTHERS:
        return known
    below = np.flatnonzero(known & under)
    away, _ = KDTree(_hue(colour[around])).query(_hue(colour[below]), distance_upper_bound=LIKE)
    found = known.copy()
    found[below[~np.isfinite(away)]] = False
    return found


def _hue(colour: Picture) -> Picture:
    """(n, 3) colours of sum one: those of a surface in light and in shade are the same."""
    return np.asarray(colour / np.maximum(colour.sum(-1, keepdims=True), 1e-3))


def _near(looks: Picture, look: Picture, tolerance: float) -> Flags:
    """(views, n) which of (3, views, n) colours differ from (3, n) by less than a tolerance, in all channels."""
    red, green, blue = (np.abs(channel - one) < tolerance for channel, one in zip(looks, look, strict=True))
    return np.asarray(red & green & blue)
