"""How long to wait for an arm."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Deadlines:
    """How long to wait, on the host's clock. A simulated arm on a busy computer needs longer deadlines than a real rig."""

    stale_s: float = 0.2  # without a new sample for this long, the data stream counts as stopped [s]
    watchdog_hz: float = 5.0  # the controller stops its program when it receives nothing for one period [Hz]
    accept_s: float = 2.0  # until the controller accepts a motion [s]
    connect_s: float = 15.0  # until the control program runs [s]
