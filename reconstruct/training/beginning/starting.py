"""How a training begins, or goes on from its newest checkpoint."""

from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from koala3d.datasets.core.budgets import require_room
from koala3d.datasets.core.console import hint
from koala3d.datasets.core.files import refuse_existing
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.rendering.pictures import Renderer
from koala3d.reconstruct.run import CHECKPOINTS, Run, copies_beside
from koala3d.reconstruct.training.beginning.series import WEIGHTS, facts_of_series, with_weights
from koala3d.reconstruct.training.decisions import record
from koala3d.reconstruct.training.decisions.decide import normalisation_of
from koala3d.reconstruct.training.decisions.skip import Skip
from koala3d.reconstruct.training.pace.budget import Plan
from koala3d.reconstruct.training.pace.clock import Clock
from koala3d.reconstruct.training.preparation import Prepared, prepare
from koala3d.reconstruct.training.step import TrainState
from koala3d.reconstruct.training.training import Training

LOOKS = 40
"""Lines in the log over a whole training."""
LINE_BYTES = 4000
"""More than a line of the log takes."""


def start(
    scene: Scene,
    scene_path: Path,
    config: Config,
    out: Path,
    budget_s: float | None = None,
    start_from: Run | None = None,
    *,
    series: bool = False,
) -> Training:
    """A training that is about to begin, its run written into `out`; see `train`."""
    refuse_existing(out)
    known = None if start_from is None else facts_of_series(scene, start_from) if series else start_from.facts
    normalisation = normalisation_of(scene, config) if known is None else known.normalisation
    prepared = prepare(scene, config, normalisation, known, copies=copies_beside(out), budget_s=budget_s)
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
    if start_from is not None and series:
        state, taken = with_weights(state, start_from)
        about[WEIGHTS] = {"run": str(start_from.path.resolve()), "step": taken, "scene": start_from.scene_path}
    elif start_from is not None:
        state = _continued(state, start_from)
        about["from"] = str(start_from.path.resolve())
    _require_room(out, state)
    skips = prepared.skips if start_from is None else record.read(start_from.path)  # its configuration is theirs already
    record.write(out, skips)
    run = Run.create(out, config, scene_path, prepared.step.facts, about)
    return _training(run, prepared, state, Clock(config.train.steps, budget_s), skips)


def _continued(fresh: TrainState, run: Run) -> TrainState:
    """The newest state of a run, its steps counted from zero again.

    Raises:
        ReconstructError: the run was trained with other sizes, or has no checkpoint.
    """
    state, _ = checkpoint.load(run.path / CHECKPOINTS, fresh)
    return eqx.tree_at(lambda s: (s.step, s.skipped), state, (fresh.step, fresh.skipped))


def resumed(scene: Scene, out: Path, budget_s: float | None) -> Training:
    """The training of a run from its newest checkpoint on; from its first step where it was killed before there was one."""
    run = Run.open(out)
    prepared = prepare(scene, run.config, run.normalisation, run.facts, fresh=False, copies=run.copies)
    state, stored, source = prepared.state, {"seconds": 0.0}, run.content.get("from")
    if checkpoint.steps(run.path / CHECKPOINTS):
        state, stored = checkpoint.load(run.path / CHECKPOINTS, state)
    elif source is not None:
        state = _continued(state, Run.open(Path(source)))
    elif WEIGHTS in run.content:
        state, _ = with_weights(state, Run.open(Path(run.content[WEIGHTS]["run"])))
    _require_room(out, state)
    run.rewind(int(state.step))
    seconds = stored.pop("seconds")
    counts = {name: int(value) for name, value in stored.items()}
    known, plan = run.content.get("budget_s"), run.content.get("plan")
    plan = None if plan is None else Plan.of_json(plan)
    if plan is not None and budget_s not in (None, known):
        hint(f"goes on to the {plan.legs[-1].steps} steps that were planned for {known:g} s")
        budget_s = known
    clock = Clock(run.config.train.steps, budget_s or known, seconds, **counts, legs=[] if plan is None else plan.legs)
    training = _training(run, prepared, state, clock, record.read(out))
    training.plan = plan
    return training


def _require_room(out: Path, state: TrainState) -> None:
    """Raise KoalaError where the disk has no room for the log and the checkpoints, one of them unfinished."""
    checkpoints = checkpoint.KEPT + 1 - len(checkpoint.steps(out / CHECKPOINTS))
    require_room(out, checkpoints * checkpoint.state_bytes(state) + LOOKS * LINE_BYTES, "the checkpoints and the log")


def _training(run: Run, prepared: Prepared, state: TrainState, clock: Clock, skips: list[Skip]) -> Training:
    step, _, pixels, probe, pool, _ = prepared
    renderer = Renderer(run.normalisation, light=run.facts.light)
    return Training(run, step, state, pixels, probe, clock, renderer, pool, skips)
