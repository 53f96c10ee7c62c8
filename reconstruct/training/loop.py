"""The training loop: prepare, step until the budget or the steps are spent, log, checkpoint, resume."""

import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from koala3d.datasets.core.console import hint, progress
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.convergence import figures_of, got_worse, warn_early
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.scene import poses
from koala3d.reconstruct.training import distributed
from koala3d.reconstruct.training.beginning.starting import LOOKS, resumed, start
from koala3d.reconstruct.training.decisions import empty_space, record
from koala3d.reconstruct.training.event_log import event_log, require_writer
from koala3d.reconstruct.training.pace import budget
from koala3d.reconstruct.training.pace.pause import give_way
from koala3d.reconstruct.training.training import Training


def train(
    scene: Scene,
    scene_path: Path,
    config: Config,
    out: Path,
    *,
    budget_s: float | None = None,
    resume: bool = False,
    start_from: Run | None = None,
    series: bool = False,
    watch: Callable[[Training, Model, dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Train on the scene's train views and leave a run in `out`.

    Args:
        budget_s: seconds of training proper, after images are read and the step is compiled. A short trial of the step finds
            out how many steps that is (see `budget`), and `config.train.steps` repeats a training of as many bit for bit. None
            trains `config.train.steps` steps.
        resume: continue the run in `out`, to the result that an undisturbed training would have had. One that was killed before
            its first checkpoint starts over.
        start_from: begin with what this run has learned, optimiser and occupancy grid included, instead of fresh weights.
        series: the run is of another object of a series: begin with its weights alone, see `training.beginning.series`.
        watch: called with the training, its model and the line of the log at each look.

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
        if begun:
            training = resumed(scene, folder, budget_s)
        else:
            training = start(scene, scene_path, config, folder, budget_s, start_from, series=series)
        training.watch = watch
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
    log = training.run.log()
    last = log[-1]
    for finding in got_worse(log):
        hint(finding.line)
    skips = empty_space.with_outcome(training.skips, last)
    record.write(out, skips)
    model = training.state.model
    poses.write(out, scene, training.run.normalisation, *distributed.own_copy((model.poses, model.session)))
    return {
        "steps": training.clock.step,
        "steps_corrected": len(training.clock.legs) > 1,
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
    with _interrupt_between_chunks() as interrupted:
        budget.begin(training)
        next_look, next_save = clock.progress + 1 / LOOKS, time.monotonic() + training.run.config.train.checkpoint_s
        total, unit = (clock.steps, "steps") if clock.budget_s is None else (clock.budget_s, "s")
        with progress("training", total, unit) as shown:
            shown.advance(total * clock.progress)
            while clock.progress < 1:
                before, begun = clock.progress, time.monotonic()
                terms = training.chunk()
                give_way(training.run.path, time.monotonic() - begun, until=interrupted)
                said = distributed.gathered([clock.seconds, interrupted()])
                clock.seconds = float(said[0, 0])
                budget.check(training)
                if clock.progress >= next_look or clock.progress >= 1:
                    shown.note(figures_of(training.look(terms)))
                    next_look = clock.progress + 1 / LOOKS
                    warn_early(training.run.log())
                if said[:, 1].any():
                    training.save()
                    raise KeyboardInterrupt
                if time.monotonic() > next_save:
                    training.save()
                    next_save = time.monotonic() + training.run.config.train.checkpoint_s
                shown.advance(total * (clock.progress - before))


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
