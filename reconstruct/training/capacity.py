"""How many rows the tables have: as many as the samples to come can fill.

A table with too few rows stops a training at a ceiling, since many vertices share a row; one with too many takes longer at each
step and learns each row from fewer samples. docs/lab/2026-11-29-rows-for-the-steps-to-come.md has the figures.
"""

import math

import jax

from koala3d.datasets.core.console import hint
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.field.encodings.create import FEWEST_ROWS
from koala3d.reconstruct.training.ray_count import LEAST, samples_of

SAMPLES_PER_ROW = 800
"""Of a training for each row of a level."""
MOST_ROWS = 19
"""Logarithm to base 2 of the rows that no training goes beyond by itself."""
CPU_STEP_S, DEVICE_STEP_S = 0.006, 0.002
"""Roughly the seconds of a step, on a processor and on an accelerator."""


def with_rows(config: Config, budget_s: float | None) -> Config:
    """The configuration with an `encoding.log2_size` for the length of the training, unless it is set or there are no tables.

    Args:
        budget_s: seconds of training; None: as many steps as configured.
    """
    if config.encoding.log2_size is not None or config.encoding.kind == "frequencies":
        return config
    on_cpu, samples = jax.default_backend() == "cpu", samples_of(config.sampler)
    samples = samples if on_cpu else max(LEAST, samples)
    steps = config.train.steps if budget_s is None else budget_s / (CPU_STEP_S if on_cpu else DEVICE_STEP_S)
    worth = round(math.log2(max(steps * samples / SAMPLES_PER_ROW, 1)))
    log2_size = min(max(worth, FEWEST_ROWS), MOST_ROWS)
    if log2_size > FEWEST_ROWS:
        hint(f"2^{log2_size} rows for each level, in a training of this length: encoding.log2_size={log2_size}")
    encoding = config.encoding.model_copy(update={"log2_size": log2_size})
    return config.model_copy(update={"encoding": encoding})
