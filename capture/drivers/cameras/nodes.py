"""Settings of a camera by the names that it gives them, in most cases those of GenICam; each is read back where it is written."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

from koala3d.capture.drivers.errors import CaptureError


class Limits(NamedTuple):
    """What a number may be: from `low` to `high` in steps from `low`; `step` 0: any value between."""

    low: float
    high: float
    step: float = 0.0

    def nearest(self, value: float) -> float:
        """The nearest that it may be. A value outside stays as it is, so that the camera refuses it."""
        if not (self.step and self.low <= value <= self.high):
            return value
        steps = min(round((value - self.low) / self.step), math.floor((self.high - self.low) / self.step))
        return self.low + steps * self.step


class Nodes(Protocol):
    """A camera's settings."""

    def has(self, name: str) -> bool:
        """Whether the setting exists and can be read or written now: commands can only be written."""
        ...

    def read(self, name: str) -> Any:
        """Its value."""
        ...

    def symbolics(self, name: str) -> Collection[str]:
        """The values of an enumeration; empty for a number."""
        ...

    def write(self, name: str, value: Any) -> None:
        """Set it, or run it where it is a command and `value` is None. Raises CaptureError where the camera refuses."""
        ...


def put(nodes: Nodes, name: str, value: Any, *, tolerance: float = 0.0) -> None:
    """Write a setting and read it back. Raises CaptureError: it has another value then."""
    nodes.write(name, value)
    actual = nodes.read(name)
    if actual != value and not (tolerance and abs(actual - value) <= tolerance):
        raise CaptureError(f"camera changed {name}", why=f"requested {value}, actual {actual}", remedy="use another setting")


def put_all(nodes: Nodes, settings: Mapping[str, bool | int | float | str], where: str) -> None:
    """Write the settings of a rig file in the given order. Raises CaptureError: one does not exist, is rejected or changed."""
    for name, value in settings.items():
        if not nodes.has(name):
            why, remedy = f"{value} was requested", "look up its name in the camera's manual, or remove it from camera.settings"
            raise CaptureError(f"camera has no setting {name}", where=where, why=why, remedy=remedy)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        put(nodes, name, value, tolerance=1e-3 * abs(float(value)) + 1e-6 if is_number else 0.0)


class _TriedNodes:
    """Settings that are written to a camera, each with the value that it had before; commands are not run."""

    def __init__(self, under: Nodes) -> None:
        self._under = under
        self._before: dict[str, Any] = {}
        self.has, self.read, self.symbolics = under.has, under.read, under.symbolics

    def write(self, name: str, value: Any) -> None:
        """See `Nodes`."""
        if value is None:
            return
        if name not in self._before:
            self._before[name] = self._under.read(name)
        self._under.write(name, value)

    def put_back(self) -> None:
        """Write the values from before, the latest first: a selector decides what the settings behind it are."""
        for name, value in reversed(self._before.items()):
            if self._under.read(name) != value:
                self._under.write(name, value)


@contextmanager
def tried(nodes: Nodes) -> Iterator[Nodes]:
    """The settings to try values with: all are put back at the end. Raises CaptureError: the camera rejects what it had."""
    under = _TriedNodes(nodes)
    try:
        yield under
    finally:
        under.put_back()


def first(nodes: Nodes, names: Collection[str], suits: Callable[[str], bool] = lambda name: True) -> str | None:
    """The first of the names that the camera has and that `suits`."""
    return next((name for name in names if nodes.has(name) and suits(name)), None)
