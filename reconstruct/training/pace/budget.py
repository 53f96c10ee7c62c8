"""How many steps a budget of seconds is: from a short trial of the step, corrected on the way if steps are slower or faster.

The trial's steps are thrown away, and their time counts. From then on the training is one of a known number of steps, which
`train.steps` repeats to the bit where nothing was corrected. RUN/run.json keeps the number and what it was found from.
"""

import time
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from koala3d.reconstruct.training import distributed
from koala3d.reconstruct.training.pace.clock import Clock, Leg
from koala3d.reconstruct.training.schedule import Schedule

if TYPE_CHECKING:
    from koala3d.reconstruct.training.training import Training

SHARE, LONGEST_S = 0.04, 2.0
"""The trial takes this share of the budget, and no longer than this."""
OFTEN = 2
"""Chunks of plain steps in a trial for one second pass."""
CHECKS = (0.25, 0.5, 0.75)
"""Shares of the budget after which the number of steps is looked at again."""
TOLERANCE = 0.05
"""A number of steps that is wrong by less is left as it is."""


@dataclass(frozen=True)
class Plan:
    """What the number of steps was found from, and what became of it. Kept in run.json as "plan"."""

    plain_s: float
    """Time of a step without second pass, the sampler's upkeep included."""
    second_s: float
    """Time of a step with it."""
    began: tuple[float, int, int]
    """Seconds, steps and second passes when it was made, or looked at last."""
    legs: list[Leg] = field(default_factory=list)
    checked: int = 0
    """How often it was looked at again."""

    @classmethod
    def of_json(cls, content: dict[str, Any]) -> "Plan":
        """As `to_json` wrote it."""
        seconds, step, passes = content["began"]
        legs = [Leg(int(step), float(progress), int(steps)) for step, progress, steps in content["legs"]]
        return cls(content["plain_s"], content["second_s"], (seconds, int(step), int(passes)), legs, int(content["checked"]))

    def to_json(self) -> dict[str, Any]:
        """For run.json."""
        return asdict(self)

    def step_s(self, schedule: Schedule, begin: float) -> float:
        """Mean time of a step from this progress to the end: second passes become more frequent."""
        if not schedule.config.surface.enabled:
            return self.plain_s
        places = begin + (1 - begin) * (np.arange(256) + 0.5) / 256
        periods = [schedule.second_pass_period(place) for place in places]
        share = float(np.mean(1 / np.array(periods, np.float64)))
        return self.plain_s + share * (self.second_s - self.plain_s)

    def leg(self, clock: Clock, schedule: Schedule, begin: float, rate: float = 1.0) -> Leg:
        """From now to the end of the budget, on a machine whose steps take `rate` times as long as in the trial."""
        assert clock.budget_s is not None
        step_s = rate * self.step_s(schedule, begin)
        return Leg(clock.step, begin, clock.step + max(1, round((clock.budget_s - clock.seconds) / step_s)))

    def corrected(self, clock: Clock, schedule: Schedule) -> "Plan":
        """The plan as it is now, with one more leg if the last one would miss the budget by the rate since the last look."""
        seconds, step, passes = self.began
        passes = clock.passes - passes
        planned_s = self.plain_s * (clock.step - step - passes) + self.second_s * passes
        leg = self.leg(clock, schedule, clock.progress, (clock.seconds - seconds) / planned_s)
        wrong = abs(leg.steps / self.legs[-1].steps - 1) > TOLERANCE
        legs = [*self.legs, leg] if wrong else self.legs
        return Plan(self.plain_s, self.second_s, (clock.seconds, clock.step, clock.passes), legs, self.checked + 1)


def begin(training: "Training") -> None:
    """Find the number of steps where there is a budget and it is not known yet."""
    clock = training.clock
    if clock.budget_s is None or clock.legs:
        return
    done = min(0.999, clock.seconds / clock.budget_s) if clock.step else 0.0
    started = time.perf_counter()
    plain_s, second_s = _tried(training, clock.budget_s)
    clock.seconds = distributed.decided(clock.seconds + time.perf_counter() - started)
    plan = Plan(plain_s, second_s, (clock.seconds, clock.step, clock.passes))
    plan.legs.append(plan.leg(clock, training.one_step.schedule, done))
    _follow(training, plan)


def check(training: "Training") -> None:
    """After each of `CHECKS`, in steps or in seconds, correct the number of steps. Every process has the same clock."""
    clock, plan = training.clock, training.plan
    if clock.budget_s is None or plan is None or clock.step <= plan.began[1] or clock.progress >= 1:
        return
    if plan.checked < len(CHECKS) and max(clock.progress, clock.seconds / clock.budget_s) >= CHECKS[plan.checked]:
        _follow(training, plan.corrected(clock, training.one_step.schedule))


def _follow(training: "Training", plan: Plan) -> None:
    training.plan = plan
    training.clock.legs, training.clock.steps = plan.legs, plan.legs[-1].steps
    training.run.amend({"plan": plan.to_json()})


def _tried(training: "Training", budget_s: float) -> tuple[float, float]:
    """Seconds of a step without and with the second pass, by steps on a copy of the state."""
    from koala3d.reconstruct.training.training import CHUNK

    seed, surface = jnp.asarray(training.run.config.train.seed, jnp.int32), training.run.config.surface
    plain: list[float] = []
    passes: list[float] = []
    state, longest = jax.tree.map(jnp.copy, training.state), min(LONGEST_S, SHARE * budget_s)
    begun, progress = time.perf_counter(), jnp.zeros((), jnp.float32)

    def timed(state: Any, count: int, second: bool) -> tuple[Any, float]:
        start = time.perf_counter()
        state, terms = training.advance(
            state, training.pixels, seed, progress, count, second, jnp.asarray(training.clock.looks, bool)
        )
        if count == CHUNK and len(plain) % 2 and state.model.sampler.upkeep_due(2 * count, 0.5):  # as often as half-way
            state = training.keep_up(state, seed)
        jax.block_until_ready((state, terms))
        return state, (time.perf_counter() - start) / count

    state, first = timed(state, 1, False)
    count = int(np.clip(distributed.decided(longest / 8 / max(first, 1e-6)), 1, CHUNK))
    while not plain or distributed.decided(time.perf_counter() - begun) < longest:
        state, seconds = timed(state, count, False)
        plain.append(seconds)
        if surface.enabled and len(passes) <= len(plain) // OFTEN:
            state, seconds = timed(state, 1, True)
            passes.append(seconds)
    plain_s = distributed.decided(_mean(plain))
    return plain_s, distributed.decided(_mean(passes)) if passes else plain_s


def _mean(seconds: list[float]) -> float:
    """Without the first, which finds nothing in the cache, where there are more."""
    return float(np.mean(seconds[1:] or seconds))
