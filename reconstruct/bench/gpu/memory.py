"""What a step needs and moves, as the compiler plans it: programs are compiled at their full sizes and never run.

`python -m koala3d.reconstruct.bench.gpu.memory SETTINGS.json RESULT.json` does it in a process of its own: it holds the device.
"""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files
from koala3d.reconstruct.config import Config

FORMAT, VERSION = "koala-bench-memory", 1
VIEWS, SIDE = 100, 800
"""Training views of the published scenes, and their width and height in pixels."""
ROOM = 24 * 10**9
"""Memory of a large consumer's card [bytes]."""
STAGES = ("begin", "regularise", "descend")
MOST = 64
"""Batches of a step at most."""


def plans(config: Config, room: int = ROOM, pixels: int = VIEWS * SIDE**2) -> list[dict[str, Any]]:
    """Steps of as many rays as configured in one batch, then in as many as fit into `room` bytes: the same mean gradient.

    Args:
        pixels: of the training views, which are on the device too.
    """
    batches, found = 1, []
    while True:
        found.append(plan(in_batches(config, batches), pixels) | {"room_bytes": room})
        needed = found[-1]["needed_bytes"]
        found[-1]["fits"] = needed <= room
        if needed <= room or batches >= MOST:
            return found
        batches *= 2 ** max(1, math.ceil(math.log2(needed / room)))


def in_batches(config: Config, count: int) -> Config:
    """The configuration with each step's rays in `count` batches."""
    sampler, surface = config.sampler, config.surface
    sizes = {"rays": max(1, sampler.rays // count), "samples": max(1, sampler.samples // count)}
    changed = {
        "sampler": sampler.model_copy(update=sizes),
        "surface": surface.model_copy(update={"rays": max(1, surface.rays // count)}),
        "train": config.train.model_copy(update={"accumulate": config.train.accumulate * count}),
    }
    return config.model_copy(update=changed)


def plan(config: Config, pixels: int) -> dict[str, Any]:
    """Memory and work of one step, by stage.

    Returns:
        "stages" of dictionaries: name, times it runs in a step, bytes of arguments, results and what is kept in between,
        operations and bytes moved of one run; and "needed_bytes" of the step, its pixels included.
    """
    import jax
    import jax.numpy as jnp

    from koala3d.reconstruct.scene.facts import SceneFacts
    from koala3d.reconstruct.scene.rays import Normalisation, Pixels
    from koala3d.reconstruct.training.step import Step

    def table() -> Pixels:
        colour, view = jnp.ones((pixels, 4), jnp.float16), jnp.zeros(pixels, jnp.int32)
        return Pixels(colour, jnp.ones((pixels, 3)), view, jnp.zeros((VIEWS, 3)), jnp.ones(VIEWS))

    step = Step.of(config, SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 2.0, 6.0)))
    state = jax.eval_shape(lambda: step.initial(jax.random.key(0), None, VIEWS))
    programs = step.compiled(state, jax.eval_shape(table))
    count = config.train.accumulate
    named = zip(STAGES if programs.regularise is not None else STAGES[::2], programs.stages, strict=True)
    stages = [_stage(name, 1 if name == STAGES[-1] else count, program) for name, program in named]
    return {"rays": config.sampler.rays, "batches": count, "stages": stages, "needed_bytes": programs.needed_bytes()}


def _stage(name: str, times: int, program: Any) -> dict[str, Any]:
    sizes, work = program.memory_analysis(), program.cost_analysis() or {}
    return {
        "name": name,
        "times": times,
        "argument_bytes": int(sizes.argument_size_in_bytes),
        "result_bytes": int(sizes.output_size_in_bytes - sizes.alias_size_in_bytes),
        "between_bytes": int(sizes.temp_size_in_bytes),
        "operations": float(work.get("flops", 0.0)),
        "moved_bytes": float(work.get("bytes accessed", 0.0)),
    }


def text(found: Sequence[dict[str, Any]]) -> str:
    """The plans as a table, a line per stage."""
    lines = [f"{'':<24}{'arguments':>12}{'results':>12}{'between':>12}{'operations':>14}{'moved':>12}"]
    for one in found:
        lines.append(f"{one['batches']} x {one['rays']} rays")
        for stage in one["stages"]:
            sizes = "".join(f"{stage[name] / 1e9:>9.2f} GB" for name in ("argument_bytes", "result_bytes", "between_bytes"))
            work = f"{stage['operations'] / 1e9:>12.0f} G{stage['moved_bytes'] / 1e9:>9.1f} GB"
            lines.append(f"  {stage['times']} x {stage['name']:<18}{sizes}{work}")
        verdict = "fits into" if one["fits"] else "more than"
        lines.append(f"  needs {one['needed_bytes'] / 1e9:.2f} GB, {verdict} {one['room_bytes'] / 1e9:.2f} GB")
    return "\n".join(lines)


def main(arguments: list[str]) -> None:
    """Plan for the settings in the first file and write the result to the second."""
    from koala3d.reconstruct.backend import cache_compilations
    from koala3d.reconstruct.models import load_config

    order = files.read_json(Path(arguments[0]), kind=FORMAT, version=VERSION)
    cache_compilations()
    found = plans(load_config("surfnerf", "paper", order["settings"]), pixels=order["pixels"])
    files.write_json(Path(arguments[1]), {"format": FORMAT, "version": VERSION, "plans": found})


if __name__ == "__main__":
    main(sys.argv[1:])
