"""Settings of a camera by their GenICam names, each read back where it is written."""

from collections.abc import Callable, Collection
from typing import Any, Protocol

from capture.errors import CaptureError


class Nodes(Protocol):
    """A camera's settings."""

    def has(self, name: str) -> bool:
        """Whether the setting exists and can be read now."""
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


def first(nodes: Nodes, names: Collection[str], suits: Callable[[str], bool] = lambda name: True) -> str | None:
    """The first of the names that the camera has and that `suits`."""
    return next((name for name in names if nodes.has(name) and suits(name)), None)
