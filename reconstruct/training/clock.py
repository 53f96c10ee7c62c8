"""How far a training is."""

from dataclasses import dataclass


@dataclass
class Clock:
    """How far a training is: in steps, or where a budget is given in seconds of training proper."""

    steps: int
    budget_s: float | None
    seconds: float = 0.0
    step: int = 0
    since_second_pass: int = 0
    since_look: int = 0
    lenience: int = 1
    """How many times rarer second passes are than in the curriculum."""
    passes: int = 0
    passes_left_out: int = 0

    @property
    def progress(self) -> float:
        """Share of the training that is done, 0 to 1."""
        return min(1.0, self.step / self.steps if self.budget_s is None else self.seconds / self.budget_s)
