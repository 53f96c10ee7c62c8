"""Moments that a test observes in place of seconds that it counts: wait for one, act at one, or let time pass by hand."""

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

LOOK_S = 0.005
"""Time between two looks."""
PATIENCE_S = 60.0
"""What takes longer than this on a busy machine does not happen at all."""


def until(holds: Callable[[], object], what: str, patience_s: float = PATIENCE_S) -> None:
    """Return at the moment at which `holds` becomes true. Raises AssertionError, which names `what`: it never did."""
    deadline = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < deadline, f"did not come within {patience_s:.0f} s: {what}"
        time.sleep(LOOK_S)


@contextmanager
def as_soon_as(holds: Callable[[], object], act: Callable[[], object], what: str) -> Iterator[None]:
    """Act once, from another thread, at the moment within the block at which `holds` becomes true.

    Raises AssertionError, which names `what`: the block ended first. What `holds` or `act` raises is raised at the block's end.
    """
    ended = threading.Event()

    def watch() -> bool:
        while not ended.wait(LOOK_S):
            if holds():
                act()
                return True
        return False

    with ThreadPoolExecutor(1) as threads:
        acted = threads.submit(watch)
        try:
            yield
        finally:
            ended.set()
            assert acted.result(), f"the test did nothing, since this did not come: {what}"


class Clock:
    """Stands in for the module `time` of the module under test: time passes only while that one sleeps."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    def time(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
