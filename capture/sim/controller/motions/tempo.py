"""How fast a motion runs through its profile: slowed by the speed slider, stopped by a pause."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Tempo:
    """Seconds of a profile per second of the clock: `first` at the time `since`, changing evenly to `last` within `ramp_s`."""

    phase_s: float  # where in the profile the motion is at `since` [s]
    since: float  # controller's time [s]
    first: float
    last: float
    ramp_s: float = 0.0

    def rate(self, now: float) -> float:
        """At the time `now`."""
        if now - self.since >= self.ramp_s:
            return self.last
        return self.first + (now - self.since) / self.ramp_s * (self.last - self.first)

    def phase(self, now: float) -> float:
        """Where in the profile the motion is at the time `now` [s]."""
        passed = now - self.since
        ramp = min(passed, self.ramp_s)
        return self.phase_s + ramp * (self.first + self.rate(self.since + ramp)) / 2 + (passed - ramp) * self.last

    def stopped(self, now: float) -> bool:
        """Whether the motion is paused and at rest."""
        return self.last <= 0 and self.rate(now) <= 0
