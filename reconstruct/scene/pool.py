"""Training on more pixels than memory should hold: a pool of random ones of every view, which the views renew in turn.

A step draws from the pool as it would from all pixels. Once its pixels have been drawn a few times, those of the next view are
replaced by others of that view. Which ones depends on the number of steps alone, so a training repeats and resumes to the bit.
Pictures are mapped from their copies, not held; rays are made from the cameras for the pixels that come into the pool.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property, partial

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from koala3d.datasets.core.budgets import budget
from koala3d.datasets.imaging.copies import Copies
from koala3d.datasets.scene import View
from koala3d.reconstruct.scene.rays import Normalisation, Pixels, pixel_counts, view_pixels

MOST, MOST_PIXELS = "KOALA_TRAINING_PIXELS", 2**25
"""Pixels that are held in memory, of 24 bytes each; the environment variable replaces the number."""
OVERVIEW = 2**22
"""Pixels of all views together where a glance at the pictures is enough."""
REUSE = 4
"""How often each pixel of the pool is drawn, on average, before it is replaced."""
HELD = 4096
"""Pixels that never come into the pool."""

Part = tuple[Float[np.ndarray, "n 4"], Float[np.ndarray, "n 3"]]
"""Colours and directions of one view's pixels in the pool."""


@dataclass
class Pool:
    """The pool of one training."""

    views: tuple[View, ...]
    normalisation: Normalisation
    scale: float
    copies: Copies | None = None
    most: int = field(default_factory=lambda: budget(MOST, MOST_PIXELS))
    """Pixels of the pool."""
    rays: int = 1
    """Pixels that a step draws."""
    _turns: int = 0
    _next: Future[Part] | None = None
    _reader: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "pool"))

    @cached_property
    def sizes(self) -> Int[np.ndarray, " views"]:
        """Pixels of each view."""
        return pixel_counts(self.views, self.scale)

    @property
    def is_needed(self) -> bool:
        """Whether there are more pixels than memory should hold."""
        return bool(self.sizes.sum() > self.most)

    @property
    def overview_scale(self) -> float:
        """The scale at which the pictures of all views together have `OVERVIEW` pixels."""
        return float(self.scale * min(1.0, np.sqrt(OVERVIEW / self.sizes.sum())))

    @cached_property
    def shares(self) -> Int[np.ndarray, " views"]:
        """Pixels of each view in the pool, the first view's first."""
        return np.maximum(1, self.most * self.sizes // self.sizes.sum())

    @property
    def period(self) -> int:
        """Steps between the turns of two views."""
        return max(1, round(REUSE * float(self.shares.sum()) / (len(self.views) * self.rays)))

    @cached_property
    def _order(self) -> Int[np.ndarray, " views"]:
        """Views in the order of their turns."""
        return np.random.default_rng(0).permutation(len(self.views))

    def drawn(self, view: int, times: int) -> Int[np.ndarray, " share"]:
        """The pixels of a view that are in the pool after so many turns of it, ascending: a random one of each equal stretch."""
        size, share = int(self.sizes[view]), int(self.shares[view])
        places = np.arange(share) + np.random.default_rng([times, view]).random(share)
        return np.minimum((places * (size / share)).astype(np.int64), size - 1)

    def _load(self, chosen: list[Int[np.ndarray, " _"]], progress) -> Pixels:
        return Pixels.load(self.views, self.normalisation, self.scale, progress, copies=self.copies, chosen=chosen)

    def pixels(self, progress) -> Pixels:
        """The pool before the first step."""
        return self._load([self.drawn(view, 0) for view in range(len(self.views))], progress)

    def _part(self, turn: int) -> Part:
        """What a turn brings into the pool."""
        times, place = divmod(turn, len(self.views))
        view = int(self._order[place])
        index = self.drawn(view, times + 1)
        return view_pixels(self.views[view], self.normalisation, self.scale, self.copies, index)

    def renewed(self, pixels: Pixels, step: int) -> Pixels:
        """The pool before a step, from what this returned for an earlier step, or from `pixels`; uses up what it is given.

        The next turn's picture is read in the background. Raises DatasetError where a picture has become unreadable.
        """
        due = step // self.period
        if due - self._turns > len(self.views):  # resumed: only each view's last turn counts
            self._turns, self._next = due - len(self.views), None
        while self._turns < due:
            part = self._part(self._turns) if self._next is None else self._next.result()
            view = self._order[self._turns % len(self.views)]
            start = np.int32(self.shares[:view].sum())
            colour, directions = _replaced((pixels.colour, pixels.directions), part, start)
            pixels = eqx.tree_at(lambda p: (p.colour, p.directions), pixels, (colour, directions))
            self._turns, self._next = self._turns + 1, None
        self._next = self._next or self._reader.submit(self._part, self._turns)
        return pixels


@partial(jax.jit, donate_argnums=0)
def _replaced(whole: tuple[Array, ...], part: Part, start: Int[Array, ""]) -> tuple[Array, ...]:
    """The rows from `start` on replaced by those of `part`."""
    return jax.tree.map(lambda old, new: jax.lax.dynamic_update_slice(old, new, (start, 0)), whole, part)
