"""Settings of cameras that pylon's emulation does not have, laid over those that it has, and faults of them.

The families differ in the names by which they encode colours; see `capture.drivers.cameras.start_state`.
"""

import time
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from koala3d.capture.drivers.cameras.genicam import FREQUENCY, LATCHES
from koala3d.capture.drivers.cameras.nodes import Nodes
from koala3d.capture.drivers.errors import CaptureError


@dataclass(frozen=True)
class Setting:
    """One setting of a simulated camera; a stuck one takes a value and keeps its own."""

    value: Any
    symbolics: tuple[str, ...] = ()
    stuck: bool = False


TICK_NS = 8
"""A tick of the clock of a simulated GigE camera, which was switched on with this computer."""
COMMON = {"DeviceTemperature": Setting(45.0), "DeviceLinkSpeed": Setting(500_000_000)}
FAMILIES: dict[str, dict[str, Setting]] = {
    "ace USB": {
        **COMMON,
        "ColorSpace": Setting("RGB", ("RGB", "sRGB")),
        "TimestampLatch": Setting(None),
        "TimestampLatchValue": Setting(0),
        "LightSourcePreset": Setting("Daylight5000K", ("Off", "Daylight5000K", "Tungsten2800K")),
    },
    "ace 2": {**COMMON, "BslColorSpace": Setting("Off", ("Off", "sRgb")), "BslTemperatureStatus": Setting("Ok")},
    "dart": {**COMMON, "BslColorSpaceMode": Setting("RGB", ("RGB", "sRGB"))},
    "ace GigE": {
        "TemperatureAbs": Setting(48.0),
        "DeviceLinkSpeed": Setting(125_000_000),
        "GammaSelector": Setting("User", ("User", "sRGB")),
        "GammaEnable": Setting(False),
        "BlackLevelRaw": Setting(32),
        "GevTimestampControlLatch": Setting(None),
        "GevTimestampValue": Setting(0),
        "GevTimestampTickFrequency": Setting(10**9 // TICK_NS),
    },
}


class SimulatedNodes:
    """The settings of a family over those of the emulation (`under`); `without` some, and with `changed` ones."""

    def __init__(
        self, under: Nodes, family: str, *, without: Collection[str] = (), changed: dict[str, Setting] | None = None
    ) -> None:
        self._under, self._without = under, set(without)
        self._over = {**FAMILIES[family], **(changed or {})}

    def has(self, name: str) -> bool:
        """See `Nodes`."""
        return name not in self._without and (name in self._over or self._under.has(name))

    def read(self, name: str) -> Any:
        """See `Nodes`."""
        return self._over[name].value if name in self._over else self._under.read(name)

    def symbolics(self, name: str) -> Collection[str]:
        """See `Nodes`."""
        return self._over[name].symbolics if name in self._over else self._under.symbolics(name)

    def write(self, name: str, value: Any) -> None:
        """See `Nodes`."""
        setting = self._over.get(name)
        if name in LATCHES and setting is not None:
            tick_ns = TICK_NS if self.has(FREQUENCY) else 1
            self._over[LATCHES[name]] = Setting(time.monotonic_ns() // tick_ns)
        elif setting is None:
            self._under.write(name, value)
        elif setting.symbolics and value not in setting.symbolics:
            raise CaptureError(f"camera rejected {name}", why=f"requested {value}, possible: {', '.join(setting.symbolics)}")
        elif not setting.stuck:
            self._over[name] = replace(setting, value=value)
