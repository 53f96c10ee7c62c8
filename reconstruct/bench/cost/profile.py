"""Where the time of a training step goes: the compiled step is traced, and `instructions` attributes it to the source."""

import gzip
import json
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from koala3d.datasets.core.console import progress
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.bench.cost.instructions import Part, module_of, parts_of
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.run import CHECKPOINTS
from koala3d.reconstruct.scene.rays import Pixels
from koala3d.reconstruct.training.step import Step, TrainState

STEPS = 16  # traced steps, without and with a second pass


def step_profile(trained: TrainedModel, scene: Scene) -> dict[str, Any]:
    """Milliseconds per step and part, with and without the second pass.

    Returns:
        "step_ms" and "second_pass_step_ms", measured without tracing; "parts": rows of stage, kernel, "forward" or
        "backward", and milliseconds of a step without second pass (stage "second pass": of a step with it), longest first.
    """
    run, views = trained.run, scene.split("train")
    step, sampler, batches = Step.of(run.config, run.facts), trained.model.sampler, run.config.train.accumulate
    state, _ = checkpoint.load(run.path / CHECKPOINTS, step.initial(jax.random.key(0)))
    with progress("reading images", len(views), "images") as shown:
        pixels = Pixels.load(views, run.normalisation, run.config.scale, shown)
    advance = step.compiled(state, pixels)
    parts = {
        (module_of(text), name): part
        for text in (stage.as_text() for stage in advance.stages)
        for name, part in parts_of(text).items()
    }
    plain_ms, plain = _traced(advance, state, pixels, parts, second=False)
    second_ms, second = _traced(advance, state, pixels, parts, second=True) if run.config.surface.enabled else (None, {})
    found = plain | {part: value for part, value in second.items() if part.stage == "second pass"}
    rows = [[part.stage, part.kernel, "backward" if part.backward else "forward", value] for part, value in found.items()]
    counts = {"rays": sampler.rays_drawn * batches, "samples": sampler.samples_drawn * batches}
    parts_of_step = sorted(rows, key=lambda row: -row[3])
    return {"step_ms": plain_ms, "second_pass_step_ms": second_ms, **counts, "parts": parts_of_step}


def _rest(count: int, second: bool) -> tuple[Any, ...]:
    """Further arguments of `Programs`: seed, progress, number of steps, whether with a second pass."""
    return jnp.asarray(0, jnp.int32), jnp.asarray(0.9, jnp.float32), count, second


def _traced(
    advance: Any, start: TrainState, pixels: Pixels, parts: dict[tuple[str, str], Part], *, second: bool
) -> tuple[float, dict[Part, float]]:
    """Milliseconds per step untraced (fastest of three) and per part; a call is one step with second pass, `STEPS` without."""
    calls, count = (STEPS, 1) if second else (1, STEPS)

    def go() -> float:
        state = jax.block_until_ready(jax.tree.map(jnp.copy, start))  # calls overwrite it
        started = time.perf_counter()
        for _ in range(calls):
            state, _ = advance(state, pixels, *_rest(count, second))
        jax.block_until_ready(state)
        return 1e3 * (time.perf_counter() - started) / STEPS

    untraced = min(go() for _ in range(3))
    with tempfile.TemporaryDirectory(prefix="koala-trace-") as folder:
        with jax.profiler.trace(folder):
            go()
        durations = durations_us(Path(folder))
    spent: dict[Part, float] = defaultdict(float)
    for name, microseconds in durations.items():
        part = parts.get(name)
        if part is not None:
            spent[part] += 1e-3 * microseconds / STEPS
    return untraced, dict(spent)


def durations_us(folder: Path) -> dict[tuple[str, str], float]:
    """Microseconds spent in each instruction of the traced programs, by its program's name and its own."""
    spent: dict[tuple[str, str], float] = defaultdict(float)
    for path in folder.rglob("*.trace.json.gz"):
        with gzip.open(path) as file:
            events = json.load(file)["traceEvents"]
        for event in events:
            told = event.get("args") or {}
            if "hlo_op" in told:
                spent[told.get("hlo_module", ""), told["hlo_op"]] += event.get("dur", 0.0)
    return dict(spent)
