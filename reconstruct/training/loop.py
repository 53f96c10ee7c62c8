"""The training loop: prepare, step until the budget or the steps are spent, log, checkpoint, resume."""

import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from datasets.core.console import hint, progress
from datasets.core.errors import UsageError
from datasets.core.files import refuse_existing
from datasets.core.space import require_room
from datasets.scene import Scene
from reconstruct import checkpoint
from reconstruct.config import Config
from reconstruct.convergence import figures_of, warn_early
from reconstruct.errors import ReconstructError
from reconstruct.rendering.pictures import Renderer
from reconstruct.rendering.probe import Probe, held_out_psnr
from reconstruct.run import CHECKPOINTS, Run, copies_beside
from reconstruct.scene import poses
from reconstruct.scene.pool import Pool
from reconstruct.scene.rays import Pixels
from reconstruct.surface.second_pass import second_pass_period
from reconstruct.training import distributed
from reconstruct.training.clock import Clock
from reconstruct.training.event_log import EventLog, event_log, require_writer
from reconstruct.training.faults import FAULTS, RECURS, cause
from reconstruct.training.pause import give_way
from reconstruct.training.preparation import Prepared, prepare
from reconstruct.training.skipping import outcome, record
from reconstruct.training.skipping.plan import normalisation_of
from reconstruct.training.step import Step, TrainState

CHUNK = 16
"""Largest number of steps between two checks of the clock."""
LOOKS = 40
"""Lines in the log over a whole training."""
LINE_BYTES = 4000
"""More than a line of the log takes."""
WORTH_DB = 0.02
"""Improvement of held-out pixels by which a training counts as still improving [dB]."""


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
    held: Pixels | None = None
    """Pixels of training views that are never trained on, like `probe`: an early stop is decided by them."""
    pool: Pool | None = None  # what renews `pixels`, where they are only a part of all
    skips: list[record.Skip] = field(default_factory=list)
    """What is left out, and why."""
    events: EventLog | None = None
    """Where each look goes beside the run's log."""
    _advance: Any = field(default=None)
    _keep_up: Any = field(default=None)
    _finite: dict[str, jax.Array] = field(default_factory=dict)

    def chunk(self) -> dict[str, jax.Array]:
        """Up to `CHUNK` steps, the last of them with the second pass where it is due.

        Returns:
            The last step's terms, or where they were not finite those of the last chunk that was; empty before there is one.
        """
        surface, clock = self.run.config.surface, self.clock
        period = clock.lenience * second_pass_period(clock.progress, first=surface.first_period, last=surface.last_period)
        left = CHUNK if clock.budget_s is not None else min(CHUNK, clock.steps - clock.step)
        until_due = period - clock.since_second_pass if surface.enabled else left
        count = max(1, min(left, until_due))
        second = surface.enabled and count >= until_due
        start, seed = time.perf_counter(), jnp.asarray(self.run.config.train.seed, jnp.int32)
        done = jnp.asarray(clock.progress, jnp.float32)
        if self.pool is not None:
            self.pixels = self.pool.renewed(self.pixels, clock.step)
        self.state, terms = self._advance(self.state, self.pixels, seed, done, count, second)
        clock.since_look += count
        if self.state.model.sampler.upkeep_due(clock.since_look, clock.progress):
            self.state = self._keep_up(self.state, seed)
            clock.since_look = 0
        jax.block_until_ready(terms)
        clock.seconds += time.perf_counter() - start
        clock.step += count
        clock.since_second_pass = 0 if second else clock.since_second_pass + count
        if second:
            self._count_second_pass(terms)
        faults = int(terms.pop(FAULTS))
        self._report_faults(faults, terms)
        if not faults:
            self._finite = terms
        return self._finite  # steps that are left out change nothing

    def _count_second_pass(self, terms: dict[str, jax.Array]) -> None:
        """Count a second pass, and find out when the next one is worth its time."""
        clock, config = self.clock, self.run.config
        clock.passes, clock.passes_left_out = clock.passes + 1, clock.passes_left_out + clock.lenience - 1
        if config.skip.consistent_passes:
            clock.lenience = outcome.lenience(clock.lenience, terms, config.surface)

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
            self.state, self.pixels = distributed.on_all((self.state, self.pixels), everywhere)
        self._advance = self.one_step.compiled(self.state, self.pixels)
        self._keep_up = self.one_step.compiled_upkeep(self.state)
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
        if self.held is not None:
            line["psnr_held_out"] = held_out_psnr(self.held, model, self.renderer)
        line |= {"skipped": int(state.skipped), "terms": {k: float(v) for k, v in terms.items()}}
        line |= model.sampler.figures()
        self.run.append_log(line)
        if self.events is not None:
            self.events.write(line)
        return line

    @property
    def exhausted(self) -> bool:
        """Whether held-out pixels got no better for as long as the configuration has patience."""
        measured = [(line["psnr_held_out"], line["progress"]) for line in self.run.log() if "psnr_held_out" in line]
        if self.held is None or not measured:
            return False
        best, since = measured[0]
        for psnr, done in measured[1:]:
            if psnr > best + WORTH_DB:
                best, since = psnr, done
        return measured[-1][1] - since >= self.run.config.train.patience

    def save(self) -> None:
        """Checkpoint state and clock, where this process is the one that does."""
        if not distributed.writes():
            return
        kept = ("seconds", "step", "since_second_pass", "since_look", "lenience", "passes", "passes_left_out")
        clock = {name: getattr(self.clock, name) for name in kept}
        checkpoint.save(self.run.path / CHECKPOINTS, self.state, clock)


def train(
    scene: Scene,
    scene_path: Path,
    config: Config,
    out: Path,
    *,
    budget_s: float | None = None,
    resume: bool = False,
    start_from: Run | None = None,
) -> dict[str, Any]:
    """Train on the scene's train views and leave a run in `out`.

    Args:
        budget_s: seconds of training proper, after images are read and the step is compiled; None trains
            `config.train.steps` steps, which is what repeats bit for bit.
        resume: continue the run in `out`, to the result that an undisturbed training would have had. One that was killed before
            its first checkpoint starts over.
        start_from: begin with what this run has learned, optimiser and occupancy grid included, instead of fresh weights.

    Raises:
        UsageError: no train views, `out` holds something else, or nothing to resume.
        ReconstructError: the training does not stay finite.
    """
    if budget_s is not None and not budget_s > 0:
        raise UsageError("budget is not a positive time", why=f"{budget_s} s")
    if config.train.tensorboard:
        require_writer()
    with distributed.folder_for(out, resume=resume) as folder:
        started = time.perf_counter()
        begun = resume and not Run.never_begun(folder)
        training = _resumed(scene, folder, budget_s) if begun else start(scene, scene_path, config, folder, budget_s, start_from)
        return _completed(training, scene, time.perf_counter() - started) | {"run": str(out)}


def _completed(training: Training, scene: Scene, prepared: float) -> dict[str, Any]:
    """Train to the end; what `train` returns."""
    out = training.run.path
    try:
        compiled = training.compile()
        wanted = training.run.config.train.tensorboard
        with event_log(out, wanted=wanted, step=training.clock.step) as training.events:
            _loop(training)
    except BaseException:
        if training.clock.step == 0:  # nothing was trained: leave nothing behind
            shutil.rmtree(out)
        raise
    training.save()
    last = training.run.log()[-1]
    skips = outcome.with_outcome(training.skips, last, passes=training.clock.passes, left_out=training.clock.passes_left_out)
    record.write(out, skips)
    poses.write(out, scene, training.run.normalisation, distributed.own_copy(training.state.model.poses))
    return {
        "steps": training.clock.step,
        "stopped_early": training.clock.progress < 1,
        "training_s": training.clock.seconds,
        "preparation_s": prepared,
        "compilation_s": compiled,
        "psnr_train": last.get("psnr_train"),
        "psnr_unseen": last.get("psnr_unseen"),
        "skipped_steps": last["skipped"],
        "skips": [asdict(skip) for skip in skips],
    }


def _loop(training: Training) -> None:
    clock = training.clock
    next_look, next_save = clock.progress + 1 / LOOKS, time.monotonic() + training.run.config.train.checkpoint_s
    total, unit = (clock.steps, "steps") if clock.budget_s is None else (clock.budget_s, "s")
    with progress("training", total, unit) as shown, _interrupt_between_chunks() as interrupted:
        shown.advance(clock.step if clock.budget_s is None else clock.seconds)
        stopped = bool(distributed.decided(training.exhausted))
        while clock.progress < 1 and not stopped:
            before = (clock.step, clock.seconds)
            begun = time.monotonic()
            terms = training.chunk()
            give_way(training.run.path, time.monotonic() - begun, until=interrupted)
            said = distributed.gathered([clock.seconds, interrupted()])
            clock.seconds = float(said[0, 0])
            if clock.progress >= next_look or clock.progress >= 1:
                shown.note(figures_of(training.look(terms)))
                next_look = clock.progress + 1 / LOOKS
                stopped = bool(distributed.decided(training.exhausted))
                warn_early(training.run.log())
            if said[:, 1].any():
                training.save()
                raise KeyboardInterrupt
            if time.monotonic() > next_save:
                training.save()
                next_save = time.monotonic() + training.run.config.train.checkpoint_s
            shown.advance(clock.step - before[0] if clock.budget_s is None else clock.seconds - before[1])


@contextmanager
def _interrupt_between_chunks() -> Iterator[Callable[[], bool]]:
    """Hold Ctrl-C back until a chunk is complete: until then the device owns the state. Yields whether it came."""
    came = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield came.is_set
        return
    before = signal.signal(signal.SIGINT, lambda *_: came.set())
    try:
        yield came.is_set
    finally:
        signal.signal(signal.SIGINT, before)


def start(
    scene: Scene, scene_path: Path, config: Config, out: Path, budget_s: float | None = None, start_from: Run | None = None
) -> Training:
    """A training that is about to begin, its run written into `out`; see `train`."""
    refuse_existing(out)
    known = None if start_from is None else start_from.facts
    normalisation = normalisation_of(scene, config) if known is None else known.normalisation
    prepared = prepare(scene, config, normalisation, known, copies=copies_beside(out))
    config, state = prepared.step.config, prepared.state
    about = {
        "scene_name": scene.name,
        "box": scene.box.tolist(),
        "bounds_from": scene.bounds_from,
        "notes": list(scene.notes),
        "budget_s": budget_s,
        "device": jax.devices()[0].device_kind,
        "devices": jax.device_count(),
        "versions": {"jax": jax.__version__, "numpy": np.__version__},
    }
    if start_from is not None:
        state = _continued(state, start_from)
        about["from"] = str(start_from.path.resolve())
    _require_room(out, state)
    record.write(out, prepared.skips)
    run = Run.create(out, config, scene_path, prepared.step.facts, about)
    return _training(run, prepared, state, Clock(config.train.steps, budget_s), prepared.skips)


def _continued(fresh: TrainState, run: Run) -> TrainState:
    """The newest state of a run, its steps counted from zero again.

    Raises:
        ReconstructError: the run was trained with other sizes, or has no checkpoint.
    """
    state, _ = checkpoint.load(run.path / CHECKPOINTS, fresh)
    return eqx.tree_at(lambda s: (s.step, s.skipped), state, (fresh.step, fresh.skipped))


def _resumed(scene: Scene, out: Path, budget_s: float | None) -> Training:
    """The training of a run from its newest checkpoint on; from its first step where it was killed before there was one."""
    run = Run.open(out)
    prepared = prepare(scene, run.config, run.normalisation, run.facts, fresh=False, copies=run.copies)
    state, clock, source = prepared.state, {"seconds": 0.0}, run.content.get("from")
    if checkpoint.steps(run.path / CHECKPOINTS):
        state, clock = checkpoint.load(run.path / CHECKPOINTS, state)
    elif source is not None:
        state = _continued(state, Run.open(Path(source)))
    _require_room(out, state)
    run.rewind(int(state.step))
    seconds = clock.pop("seconds")
    counts = {name: int(value) for name, value in clock.items()}
    budget_s = budget_s or run.content.get("budget_s")
    return _training(run, prepared, state, Clock(run.config.train.steps, budget_s, seconds, **counts), record.read(out))


def _require_room(out: Path, state: TrainState) -> None:
    """Raise KoalaError where the disk has no room for the log and the checkpoints, one of them unfinished."""
    checkpoints = checkpoint.KEPT + 1 - len(checkpoint.steps(out / CHECKPOINTS))
    require_room(out, checkpoints * checkpoint.state_bytes(state) + LOOKS * LINE_BYTES, "the checkpoints and the log")


def _training(run: Run, prepared: Prepared, state: TrainState, clock: Clock, skips: list[record.Skip]) -> Training:
    step, _, pixels, probe, held, pool, _ = prepared
    renderer = Renderer(run.normalisation, light=run.facts.light)
    return Training(run, step, state, pixels, probe, clock, renderer, held, pool, skips)
