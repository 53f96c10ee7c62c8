"""A training too small to keep, with and without a reflection: what the branch brings on this scene."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from reconstruct.config import Config
from reconstruct.models import merged_config
from reconstruct.rendering.pictures import Renderer
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.rays import Normalisation, Pixels
from reconstruct.training.step import Step

STEPS, CHUNKS = 240, 8
"""Steps of the pilot, and looks around in between."""
TESTED = 4096
"""Pixels that it is measured on."""
SMALL = {
    "encoding": {"levels": 5, "log2_size": 14, "finest": 64.0},
    "sampler": {"kind": "occupancy", "rays": 2048, "samples": 8192},
    "surface": {"enabled": False},
    "train": {"accumulate": 1, "per_image": "none"},
    "poses": {"enabled": False},
}
MATTE = {
    "field": {"appearance": "diffuse", "bottleneck": 0, "diffuse_bias": -math.log(3)},
    "surface": {"bias": 0.0, "variation": 0.0},
}
"""A model without reflection: its diffuse colour is all there is, and begins no darker than Ref-NeRF's."""


def gain_by_reflecting(config: Config, normalisation: Normalisation, pixels: Pixels, possible) -> float:
    """How much better [dB] held-out pixels are reproduced by a short training with a reflection than by one without."""
    small = merged_config(config, SMALL)
    trained, held = pixels.held_out(TESTED)
    reflecting, matte = (_error(each, normalisation, trained, held, possible) for each in (small, merged_config(small, MATTE)))
    return float(10 * np.log10(matte / reflecting))


def _error(config: Config, normalisation: Normalisation, trained: Pixels, held: Pixels, possible) -> float:
    """Mean square error on the held pixels after a short training."""
    step, seed = Step.of(config, SceneFacts(normalisation)), jnp.asarray(config.train.seed, jnp.int32)
    state = step.initial(jax.random.key(config.train.seed), possible)
    advance, keep_up = step.compiled(state, trained), step.compiled_upkeep(state)
    for chunk in range(CHUNKS):
        progress = jnp.asarray(0.1 + 0.9 * chunk / CHUNKS, jnp.float32)
        state, _ = advance(state, trained, seed, progress, STEPS // CHUNKS, False)
        state = keep_up(state, seed) if chunk else state
    *rays, target = held.over_white(np.arange(held.directions.shape[0]))
    rendered = Renderer(normalisation).rays(state.model, *rays)["rgb"]
    return float(np.mean((rendered - target) ** 2))
