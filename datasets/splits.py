"""Choices among views: some evenly spread, folds for cross-validation."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Item = TypeVar("Item")


def evenly(items: Sequence[Item], most: int) -> tuple[Item, ...]:
    """At most so many of the items, evenly spread from the first to the last."""
    return tuple(items[i] for i in np.unique(np.linspace(0, len(items) - 1, most).round().astype(int)))


def folds(count: int, most: int) -> NDArray[np.int64]:
    """(count,) fold of each of `count` views, in up to `most` folds: fold k holds out every `most`-th view from view k on."""
    return np.arange(count) % max(min(most, count), 1)
