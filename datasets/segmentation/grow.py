"""Masks that agree with each other: each view is cut where the others expect the object, and the cuts vote on space.

At first the object is expected in the middle of a ball. A cell stays expected while nearly all views that see it cut it to the
object, so that what only one view takes for the object is soon expected nowhere. Strokes hold in their own view and, through
the cells that they cross, in the others.

If the box of the object is stated, the plane that it stands on says more than colours do: see `standing`.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import count

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.core.progress import Count, Step, ignore
from koala3d.datasets.imaging import images, reduced
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.segmentation.cut import Drawn, cut
from koala3d.datasets.segmentation.space import Ball, Space
from koala3d.datasets.segmentation.standing import TIMES, Standing
from koala3d.datasets.segmentation.strokes import Stroke
from koala3d.datasets.structure.masks.silhouette import Sight

SIDE = 256
"""Longest side of the pictures that are cut [px]."""
ROUNDS = 5
KERNEL, CORE = 0.2, 0.5
"""Radii within which a cell is at first certainly the object's, so that every view has some of its colours, and likely so."""
SURE, UNSURE = 0.85, 0.7
"""Share of the views that cut a cell to the object, of the largest such share, above which it is expected to be the object's, and
above which it may be."""
FEWEST_VIEWS, SHARE_OF_VIEWS = 3, 1 / 6
"""Views that must see a cell, and their share of all: elsewhere nothing is expected."""
CERTAIN, EXPECTED, MAYBE = 1.0, 0.8, 0.45
"""Expectation of cells; see `cut.CERTAIN`, `cut.LIKELY` and `cut.POSSIBLE`."""


@dataclass(frozen=True, eq=False)
class Grown:
    """What was found."""

    masks: tuple[NDArray[np.bool_], ...]
    """For each view, (height, width) pixels of the object in its small picture."""
    agreement: NDArray[np.float64]
    """(views,) intersection over union of each mask and the silhouette of the cells that the views agree on."""


class Grower:
    """A scene's pictures, read once and cut as often as strokes are added."""

    def __init__(self, scene: Scene, ball: Ball | None = None, *, done: Step = ignore) -> None:
        """Read small pictures of all views; `done` is called after each.

        Raises:
            DatasetError: no ball is given and cameras look at no common point.
        """
        found = ball or Ball.of(scene)
        if found is None:
            what, remedy = "no point that all cameras look at", "say where the object is: --ball X Y Z RADIUS"
            raise DatasetError(what, where=scene.name, why="their axes are parallel", remedy=remedy)
        self.scene, self.ball, self.views = scene, found, scene.views
        self.space = Space(found, tuple(Sight(view.camera.within(SIDE), view.world_from_camera) for view in self.views))
        self.pictures = []
        for view in self.views:
            self.pictures.append(_picture(view))
            done()
        self._standing = Standing(scene.box, self.pictures, self.space.sights) if scene.box_is_stated else None

    def grow(self, strokes: Sequence[Stroke] = (), *, done: Count = ignore) -> Grown:
        """Cut all views until they agree; `done` is called after each cut, with the number of cuts and that of all."""
        drawn, views = [self._drawn(view, strokes) for view in self.views], len(self.views)
        masks, finished = None, 0
        if self._standing is not None and (seen := self._standing.seen) is not None:
            step = _counted(done, 0, finished := TIMES * views)
            masks = self._standing.masks(seen, drawn, done=step)
            if masks is None:
                drawn = self._standing.hints(seen, drawn)
        if masks is None:
            masks = self._by_colours(drawn, _counted(done, finished, finished + ROUNDS * views))
        sure = self._with_strokes(self._agreed(masks), drawn) >= EXPECTED
        silhouettes = [self.space.drawn(i, sure) > 0 for i in range(views)]
        agreement = [_overlap(mask, shape) for mask, shape in zip(masks, silhouettes, strict=True)]
        return Grown(tuple(masks), np.array(agreement))

    def _by_colours(self, drawn: Sequence[Drawn], done: Step) -> list[NDArray[np.bool_]]:
        """Masks of all views, cut `ROUNDS` times."""
        expected, masks = self._first(), []
        for _ in range(ROUNDS):
            asked, masks = self._with_strokes(expected, drawn), []
            with ThreadPoolExecutor(reduced.READERS) as pool:
                for mask in pool.map(partial(self._cut, asked, drawn), range(len(self.views))):
                    masks.append(mask)
                    done()
            expected = self._agreed(masks)
        return masks

    def _cut(self, expected: NDArray[np.float32], drawn: Sequence[Drawn], view: int) -> NDArray[np.bool_]:
        return cut(self.pictures[view], self.space.drawn(view, expected), drawn[view])

    def _first(self) -> NDArray[np.float32]:
        near = self.space.from_centre
        return np.select([near < KERNEL, near < CORE, near < 1], [CERTAIN, EXPECTED, MAYBE], 0.0).astype(np.float32)

    def _agreed(self, masks: Sequence[NDArray[np.bool_]]) -> NDArray[np.float32]:
        """(n,) expectation of each cell after the votes of all masks."""
        seen, shown = np.sum([self.space.votes(i, mask) for i, mask in enumerate(masks)], axis=0)
        share = np.where(seen >= max(FEWEST_VIEWS, SHARE_OF_VIEWS * len(masks)), shown / np.maximum(seen, 1), 0)
        most = max(float(share.max()), 1e-9)
        return np.select([share > SURE * most, share > UNSURE * most], [EXPECTED, MAYBE], 0.0).astype(np.float32)

    def _with_strokes(self, expected: NDArray[np.float32], drawn: Sequence[Drawn]) -> NDArray[np.float32]:
        """What is expected, less all cells under strokes of the background, and with cells of the ball under the object's."""
        raised, ruled_out = np.zeros(len(expected), bool), np.zeros(len(expected), bool)
        for i, one in enumerate(drawn):
            if one.object.any():
                raised |= self.space.votes(i, one.object)[1]
            if one.background.any():
                ruled_out |= self.space.votes(i, one.background)[1]
        possible = np.maximum(expected, np.where(raised & (self.space.from_centre < 1), MAYBE, 0))
        return np.where(ruled_out, 0, possible).astype(np.float32)

    def _drawn(self, view: View, strokes: Sequence[Stroke]) -> Drawn:
        small = view.camera.within(SIDE)
        shape = small.height, small.width
        painted = {"object": np.zeros(shape, bool), "background": np.zeros(shape, bool)}
        for stroke in strokes:
            if stroke.view == view.name:
                painted[stroke.of] |= stroke.painted(view.camera, shape)
        return Drawn(painted["object"] & ~painted["background"], painted["background"])


def _counted(done: Count, finished: int, total: int) -> Step:
    """A callback that counts up from `finished`."""
    numbers = count(finished + 1)
    return lambda: done(next(numbers), total)


def enlarged(mask: NDArray[np.bool_], width: int, height: int) -> NDArray[np.uint8]:
    """(height, width) a small mask in a picture's size, 0 or 255, with smooth outlines."""
    large = cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
    return np.where(large > 0.5, 255, 0).astype(np.uint8)


def _picture(view: View) -> NDArray[np.uint8]:
    small = view.camera.within(SIDE)
    colours = replace(view, mask=None).read_resized(small.width, small.height)[..., :3]
    return np.ascontiguousarray(images.to_uint8(images.as_float(colours)))


def _overlap(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    union = int((one | other).sum())
    return float((one & other).sum()) / union if union else 0.0
