"""Lamps that the controller's digital outputs switch."""

import logging
import time
from collections.abc import Collection
from typing import Self

from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.drivers.events import event
from koala3d.capture.drivers.ur.outputs import DigitalOutputs

log = logging.getLogger(__name__)
WARM_S = 0.2
"""Until relays have stopped bouncing (some 20 ms) and the drivers of light-emitting diodes give their full light [s]."""


class SwitchedLamps:
    """The lamps of a rig by name. Entering connects; leaving switches all of them off, after a fault and Ctrl-C as well.

    Args:
        outputs: the digital output of each lamp.
    """

    def __init__(self, host: str, outputs: dict[str, int]) -> None:
        self.outputs, self._driver = outputs, DigitalOutputs(host)
        self._burning: frozenset[str] | None = None

    def __enter__(self) -> Self:
        self._driver.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            self.switch(())
        except CaptureError as error:
            log.warning("the lamps may still burn: %s", error)
        finally:
            self._driver.__exit__(*exception)

    def switch(self, names: Collection[str]) -> None:
        """Switch these lamps on and all others off; returns when they burn steadily. Raises RigConnectionError where it fails."""
        wanted = frozenset(names)
        if wanted == self._burning:
            return
        on = {self.outputs[name] for name in wanted}
        self._driver.set_outputs(on, set(self.outputs.values()) - on)
        self._burning = wanted
        event("lamps", on=sorted(wanted))
        if wanted:
            time.sleep(WARM_S)
