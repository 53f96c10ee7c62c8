"""What the checks by picture look at: small pictures, matches and triangulated points of up to eighty views."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.console import progress
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.imaging.reduced import READERS
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.splits import evenly
from koala3d.datasets.structure import bounds, matching
from koala3d.datasets.structure.epipolar import Pairs
from koala3d.datasets.structure.matching import Matches, ViewFeatures
from koala3d.datasets.structure.triangulate import Cloud, triangulate

VIEWS = 80
"""Largest number of views that are matched. Of more, neighbours would be too far apart on shiny objects."""
OUTSTANDING = 3.5
"""A view stands out from the others beyond this many robust standard deviations of theirs."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Pictures, matches and poses of some views of a scene; what follows from them is computed when it is asked for."""

    scene: Scene
    views: tuple[View, ...]
    pictures: tuple[NDArray[np.float32], ...]
    """(height, width, 3 or 4) sRGB of each view, at most `matching.SIDE` pixels a side."""
    matches: Matches
    matrices: NDArray[np.float64]
    """(views, 4, 4) `world_from_camera`."""

    @classmethod
    def gather(cls, scene: Scene, *, count: int = VIEWS) -> "Evidence":
        """Read and match up to `count` views, evenly spread. Raises as `View.read` does."""
        views = evenly(scene.views, count)
        matrices = np.stack([view.world_from_camera for view in views])
        pictures, features = [], []
        with progress("matching pictures", len(views), "images") as shown:
            for picture, found in streamed(_searched, views, workers=READERS):
                pictures.append(picture)
                features.append(found)
                shown.advance()
        pairs = matching.pairs_of(matrices, bounds.middle(matrices, scene.box))
        return cls(scene, views, tuple(pictures), matching.joined(views, features, pairs), matrices)

    @cached_property
    def focus(self) -> NDArray[np.float64]:
        """(3,) where the cameras look."""
        return bounds.middle(self.matrices, self.scene.box)

    @cached_property
    def pairs(self) -> Pairs:
        """All matches."""
        return Pairs.of(self.matches)

    @cached_property
    def distances(self) -> NDArray[np.float64]:
        """(matches,) distance of each match of `pairs` from its epipolar plane [px]."""
        return np.abs(self.pairs.distances(self.matrices))

    @cached_property
    def cloud(self) -> Cloud:
        """Points triangulated from the matches."""
        return triangulate(self.matches, self.matrices)

    def depth(self, view: int) -> float:
        """Typical depth of what a view shows [world unit]."""
        seen = self.cloud.sightings[self.cloud.sightings[:, 1] == view, 0]
        points = self.cloud.points[seen] if len(seen) >= 10 else self.focus[None]
        ahead = (points - self.matrices[view, :3, 3]) @ self.matrices[view, :3, 2]
        return max(float(np.median(ahead)), 1e-9)

    def with_cameras(self, directions: list[NDArray[np.float64]], matrices: NDArray[np.float64]) -> "Evidence":
        """The same with other rays and poses: what is checked next is free of an error that is known."""
        features = [
            ViewFeatures(ray, one.descriptors, one.colours, one.pixel)
            for ray, one in zip(directions, self.matches.features, strict=True)
        ]
        return replace(self, matches=Matches(self.matches.views, tuple(features), self.matches.pairs), matrices=matrices)


def _searched(view: View) -> tuple[NDArray[np.float32], ViewFeatures]:
    """A view's small picture and its features."""
    picture = view.read_small(matching.SIDE)
    return picture, matching.detect_in(picture, view)
