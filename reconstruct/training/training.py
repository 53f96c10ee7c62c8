"""A training that is under way: chunks of steps, looks for the log, checkpoints."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from koala3d.datasets.core.console import hint
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.rendering.pictures import Renderer
from koala3d.reconstruct.rendering.probe import Probe
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.scene.pool import Pool
from koala3d.reconstruct.scene.rays import Pixels
from koala3d.reconstruct.training import distributed
from koala3d.reconstruct.training.decisions.skip import Skip
from koala3d.reconstruct.training.event_log import EventLog
from koala3d.reconstruct.training.faults import FAULTS, RECURS, cause
from koala3d.reconstruct.training.objective import LIT
from koala3d.reconstruct.training.pace.budget import Plan
from koala3d.reconstruct.training.pace.clock import Clock
from koala3d.reconstruct.training.step import Step, TrainState

CHUNK = 16
"""Largest number of steps between two checks of the clock."""


@dataclass
class Training:
    """A training that is under way."""

    run: Run
    one_step: Step
    state: TrainState
    pixels: Pixels
    probe: Probe | None
    clock: Clock
    renderer: Renderer
    pool: Pool | None = None  # what renews `pixels`, where they are only a part of all
    skips: list[Skip] = field(default_factory=list)
    """What is left out, and why."""
    events: EventLog | None = None
    """Where each look goes beside the run's log."""
    watch: "Callable[[Training, Model, dict[str, Any]], None] | None" = None
    """Called with the model and the line of each look."""
    plan: Plan | None = None
    """How the number of steps follows from a budget."""
    advance: Any = field(default=None)
    keep_up: Any = field(default=None)
    _finite: dict[str, jax.Array] = field(default_factory=dict)

    def chunk(self, most: int = CHUNK) -> dict[str, jax.Array]:
        """Up to `most` steps, at most `CHUNK`, the last of them with the second pass where it is due.

        Returns:
            The last step's terms, or where they were not finite those of the last chunk that was; empty before there is one.
        """
        surface, clock, schedule = self.run.config.surface, self.clock, self.one_step.schedule
        period = schedule.second_pass_period(clock.progress)
        left = most if clock.left is None else min(most, clock.left)
        until_due = period - clock.since_second_pass if surface.enabled else left
        count = max(1, min(left, until_due))
        second = surface.enabled and count >= until_due
        start, seed = time.perf_counter(), jnp.asarray(self.run.config.train.seed, jnp.int32)
        done = jnp.asarray(clock.progress, jnp.float32)
        if self.pool is not None:
            self.pixels = self.pool.renewed(self.pixels, clock.step)
        self.state, terms = self.advance(self.state, self.pixels, seed, done, count, second, jnp.asarray(clock.looks, bool))
        clock.since_upkeep += count
        due = self.state.model.sampler.upkeep_due(clock.since_upkeep, clock.progress)
        if due and schedule.rules_out_cells(clock.progress):
            self.state = self.keep_up(self.state, seed)
            clock.since_upkeep = 0
        jax.block_until_ready(terms)
        clock.seconds += time.perf_counter() - start
        clock.step += count
        clock.since_second_pass = 0 if second else clock.since_second_pass + count
        clock.passes += second
        faults = int(terms.pop(FAULTS))
        self._report_faults(faults, terms)
        if not faults:
            self._finite = terms
            clock.looks = self.state.model.sampler.ends_early(float(terms[LIT]))
        return self._finite  # steps that are left out change nothing

    def _report_faults(self, faults: int, terms: dict[str, jax.Array]) -> None:
        """Say what was not finite in the last steps. Raises ReconstructError where that recurs."""
        if not faults:
            return
        skipped, reason = int(self.state.skipped), cause(faults, self.state.model.split()[0], terms)
        hint(f"up to step {self.clock.step} {skipped} left out, not finite: {reason}")
        self.run.append_fault({"step": self.clock.step, "skipped": skipped, "cause": reason})
        if skipped >= RECURS:
            raise ReconstructError(
                "training does not stay finite",
                where=f"step {self.clock.step}",
                why=f"{skipped} steps; the last: {reason}",
                remedy="lower train.rate, and look for values that are not finite in the scene's cameras",
            )

    def compile(self) -> float:
        """Compile the step; returns the seconds that it took."""
        start = time.perf_counter()
        if (everywhere := self.one_step.division.everywhere) is not None:
            self.state = distributed.on_all(self.state, everywhere)
            whole = self.pool is not None  # which is renewed as a whole
            self.pixels = distributed.on_all(self.pixels, everywhere) if whole else self.one_step.division.divided(self.pixels)
        with ThreadPoolExecutor(1) as thread:
            keep_up = thread.submit(self.one_step.compiled_upkeep, self.state)
            self.advance = self.one_step.compiled(self.state, self.pixels)
            self.keep_up = keep_up.result()
        return time.perf_counter() - start

    def look(self, terms: dict[str, jax.Array]) -> dict[str, Any]:
        """One line for the log; renders the probe."""
        state = distributed.own_copy(self.state)
        model = state.model
        seconds, done = round(self.clock.seconds, 3), round(self.clock.progress, 5)
        line: dict[str, Any] = {"step": self.clock.step, "seconds": seconds, "progress": done}
        if "mse" in terms:
            line["psnr_train"] = -10 * float(np.log10(max(float(terms["mse"]), 1e-10)))
        if self.probe is not None:
            line["psnr_unseen"] = self.probe.psnr(model, self.renderer)
        line |= {"skipped": int(state.skipped), "terms": {k: float(v) for k, v in terms.items()}}
        line |= model.sampler.figures()
        self.run.append_log(line)
        if self.events is not None:
            self.events.write(line)
        if self.watch is not None:
            self.watch(self, model, line)
        return line

    def save(self) -> None:
        """Checkpoint state and clock, where this process is the one that does."""
        if not distributed.writes():
            return
        kept = ("seconds", "step", "since_second_pass", "since_upkeep", "passes", "looks")
        clock = {name: getattr(self.clock, name) for name in kept}
        checkpoint.save(self.run.path / CHECKPOINTS, self.state, clock)
