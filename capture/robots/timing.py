"""How long to wait for an arm, and when it counts as still."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settling:
    """When the arm counts as still: every joint slower than `speed` [rad/s] for `time_s`, at the latest after `timeout_s` [s].

    The first is measured on the controller's clock, the last on the host's.
    """

    speed: float = 0.001
    time_s: float = 0.3
    timeout_s: float = 5.0


@dataclass(frozen=True)
class Deadlines:
    """How long to wait, on the host's clock. A busy computer that drives a simulated arm needs longer ones than a real rig."""

    stale_s: float = 0.2
    """No new sample for this long: the data stream stands still [s]."""
    watchdog_hz: float = 5.0
    """The controller stops its program when it hears nothing for one period [Hz]."""
    accept_s: float = 2.0
    """Until the controller takes a motion [s]."""
    connect_s: float = 15.0
    """Until the control program runs [s]."""
