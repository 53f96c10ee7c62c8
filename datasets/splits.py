"""Choices of views: every Nth for testing, some evenly spread, folds for cross-validation."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.scene import View

Item = TypeVar("Item")


def hold_out(views: Iterable[View], every: int) -> tuple[View, ...]:
    """The views with every `every`-th by sorted name, from the first on, as "test", the rest as "train"; 0 for no test views."""
    views = tuple(views)
    test = {view.name for view in sorted(views, key=lambda view: view.name)[::every]} if every > 0 else set()
    return tuple(replace(view, split="test" if view.name in test else "train") for view in views)


def evenly(items: Sequence[Item], most: int) -> tuple[Item, ...]:
    """At most so many of the items, evenly spread from the first to the last."""
    return tuple(items[i] for i in np.unique(np.linspace(0, len(items) - 1, most).round().astype(int)))


def folds(count: int, most: int) -> NDArray[np.int64]:
    """(count,) fold of each of `count` views, in up to `most` folds: fold k holds out every `most`-th view from view k on."""
    return np.arange(count) % max(min(most, count), 1)
