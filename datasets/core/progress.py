"""Callbacks by which long work says how far it is; commands connect them to a progress bar."""

from collections.abc import Callable

Step = Callable[[], None]  # called after each unit of work
Count = Callable[[int, int], None]  # called with the number of units finished and their total


def ignore(*_: object) -> None:
    """The callback of callers that do not watch."""
