"""How far a training is."""

from dataclasses import dataclass, field
from typing import NamedTuple


class Leg(NamedTuple):
    """A part of a training whose number of steps is known: progress is linear from its first step to the training's last."""

    step: int
    """Where it begins."""
    progress: float
    """The share of the training that is done there."""
    steps: int
    """All steps of the training, those before the leg included."""


@dataclass
class Clock:
    """How far a training is, in steps. Schedules follow the steps alone, so that a training can be repeated."""

    steps: int
    """All of them; with a budget a guess until the first leg is known."""
    budget_s: float | None
    seconds: float = 0.0
    step: int = 0
    since_second_pass: int = 0
    since_upkeep: int = 0
    passes: int = 0
    looks: int = 0
    """Whether the sampler looks where light ends, as the chunk before has shown (1) or not (0)."""
    legs: list[Leg] = field(default_factory=list)
    """One, and one more for each correction of a budget; none as long as a budget's steps are not known."""

    def __post_init__(self) -> None:
        if self.budget_s is None:
            self.legs = [Leg(0, 0.0, self.steps)]
        elif self.legs:
            self.steps = self.legs[-1].steps

    @property
    def leg(self) -> Leg | None:
        """The one that the next step belongs to."""
        return next((leg for leg in reversed(self.legs) if leg.step <= self.step), None)

    @property
    def left(self) -> int | None:
        """Steps to the end of the leg: the next leg's beginning is an end too. None where it is not known."""
        if self.leg is None:
            return None
        ends = [leg.step for leg in self.legs if leg.step > self.step]
        return min([self.leg.steps, *ends]) - self.step

    @property
    def progress(self) -> float:
        """Share of the training that is done, 0 to 1."""
        if (leg := self.leg) is None:
            return 0.0
        if self.step >= leg.steps:
            return 1.0
        return leg.progress + (1.0 - leg.progress) * ((self.step - leg.step) / (leg.steps - leg.step))
