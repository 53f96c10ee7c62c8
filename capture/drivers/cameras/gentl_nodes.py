"""Settings of a GenICam camera through the reference implementation of the standard (genicam), and the errors of that library."""

from collections.abc import Collection
from typing import Any

from koala3d.capture.drivers.cameras.base import first_line
from koala3d.capture.drivers.cameras.genicam import CHANGE
from koala3d.capture.drivers.cameras.nodes import Limits
from koala3d.capture.drivers.errors import CaptureError


class GenTlNodes:
    """`capture.drivers.cameras.nodes.Nodes` of an opened camera."""

    def __init__(self, node_map: Any) -> None:
        self._map = node_map

    def node(self, name: str) -> Any:
        """The node itself."""
        return self._map.get_node(name)

    def has(self, name: str) -> bool:
        """Commands, which may only be written, count as present."""
        from genicam.genapi import EAccessMode

        if not self._map.has_node(name):
            return False
        return self.node(name).get_access_mode() in (EAccessMode.RO, EAccessMode.RW, EAccessMode.WO)

    def read(self, name: str) -> Any:
        """Its value."""
        return self.node(name).value

    def symbolics(self, name: str) -> Collection[str]:
        """Names of an enumeration's values."""
        return tuple(getattr(self.node(name), "symbolics", ()))

    def limits(self, name: str) -> Limits:
        """What a number may be now."""
        node = self.node(name)
        return Limits(node.min, node.max, node.inc if getattr(node, "has_inc", lambda: True)() else 0.0)

    def write(self, name: str, value: Any) -> None:
        """A command takes None."""
        try:
            if value is None:
                self.node(name).execute()
            else:
                self.node(name).value = value
        except Exception as error:
            if not (is_vendors(error) or isinstance(error, TypeError | AttributeError)):
                raise
            raise CaptureError(f"camera rejected {name}", why=f"requested {value}: {first_line(error)}", remedy=CHANGE) from None

    def values(self) -> dict[str, Any]:
        """All settings that can be read and have a plain value."""
        found: dict[str, Any] = {}
        for node in self._map.nodes:
            name = node.node.name if hasattr(node, "node") else ""
            if (
                name
                and node.node.is_feature()
                and self.has(name)
                and isinstance(value := tried(self.node(name)), bool | int | float | str)
            ):
                found[name] = value
        return found


def tried(thing: Any, name: str = "value") -> Any:
    """An attribute that the library may refuse to tell; None then."""
    try:
        return getattr(thing, name)
    except Exception as error:
        if is_vendors(error) or isinstance(error, AttributeError):
            return None
        raise


def is_vendors(error: BaseException) -> bool:
    """Whether an exception is of the GenApi or GenTL library."""
    from genicam import genapi, gentl

    return isinstance(error, genapi.GenericException | gentl.GenericException)
