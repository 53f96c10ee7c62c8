"""How many rays a step takes: as many as keep the device busy, and no more than it has memory for."""

import math
import os

import jax
import jax.numpy as jnp

from koala3d.datasets.core.console import hint
from koala3d.reconstruct.config import Config, SamplerConfig
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.sampling.create import sampler_type
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Pixels
from koala3d.reconstruct.training.step import Step

LEAST = 2**18
"""Samples that a batch has at least on an accelerator, if they fit."""
SHARE = 0.9
"""Share of the device's memory that a step may take."""
FEWEST = 256
"""Steps of fewer rays are refused: by then the model itself does not fit."""


def scaled(config: Config, rays: int) -> Config:
    """The configuration for steps of `rays` rays: k times fewer take k times the steps at a k times smaller rate.

    The linear scaling rule (Goyal et al. 2017), as in the paper. Second passes keep their number: their periods grow k-fold.
    """
    factor = config.sampler.rays / rays
    train, surface, samples = config.train, config.surface, round(config.sampler.samples / factor)

    def period(steps: int) -> int:
        return max(1, 2 ** round(jnp.log2(steps * factor).item()))

    changed = {
        "sampler": {"rays": rays, "samples": max(1, samples)},
        "surface": {
            "rays": max(1, round(surface.rays / factor)),
            "first_period": period(surface.first_period),
            "last_period": period(surface.last_period),
        },
        "train": {
            "rate": train.rate / factor,
            "final_rate": train.final_rate / factor,
            "steps": round(train.steps * factor),
        },
    }
    sections = {name: getattr(config, name).model_copy(update=values) for name, values in changed.items()}
    return config.model_copy(update=sections)


def sized(config: Config, facts: SceneFacts, pixels: Pixels) -> Config:
    """The configuration with batches for this device: grown on an accelerator, shrunk where memory grows with the rays."""
    if jax.default_backend() != "cpu":
        config = grown(config, facts, pixels)
    return fitted(config, facts, pixels) if sampler_type(config.sampler).memory_grows_with_rays else config


def grown(config: Config, facts: SceneFacts, pixels: Pixels, limit: int | None = None) -> Config:
    """The configuration with rays and samples doubled until a batch has `LEAST` samples, while it fits.

    Steps and learning rate stay: a larger batch has less noise, and Adam's step does not grow with it.

    Args:
        limit: bytes that a step may take; None asks the device.
    """
    limit = memory_limit() if limit is None else limit
    doublings = max(0, math.ceil(math.log2(max(1, LEAST) / samples_of(config.sampler))))
    while doublings:
        factor, sampler, surface = 2**doublings, config.sampler, config.surface
        sizes = {"rays": factor * sampler.rays, "samples": factor * sampler.samples}
        sections = {
            "sampler": sampler.model_copy(update=sizes),
            "surface": surface.model_copy(update={"rays": factor * surface.rays}),
        }
        larger = config.model_copy(update=sections)
        if needed_bytes(larger, facts, pixels) <= limit:
            hint(f"{factor} times as many rays and samples in a batch, for this device: sampler.rays={sizes['rays']}")
            return larger
        doublings -= 1
    return config


def samples_of(sampler: SamplerConfig) -> int:
    """Samples of a batch."""
    return sampler.rays * sampler.final if sampler_type(sampler).memory_grows_with_rays else sampler.samples


def fitted(config: Config, facts: SceneFacts, pixels: Pixels, limit: int | None = None) -> Config:
    """The configuration with its rays halved until a step fits into memory.

    Args:
        limit: bytes that a step may take; None asks the device.

    Raises:
        ReconstructError: not even `FEWEST` rays fit.
    """
    limit = memory_limit() if limit is None else limit
    while (needed := needed_bytes(config, facts, pixels)) > limit:
        if config.sampler.rays // 2 < FEWEST:
            raise ReconstructError(
                "the model does not fit into memory",
                why=f"a step of {config.sampler.rays} rays takes {needed >> 20} MiB of {limit >> 20}",
                remedy="lower encoding.log2_size or the widths of the networks",
            )
        config = scaled(config, config.sampler.rays // 2)
    return config


def needed_bytes(config: Config, facts: SceneFacts, pixels: Pixels) -> int:
    """Memory of a step beside its pixels, as the compiler plans it: state before and after, and everything in between.

    The step is compiled for it; the compilation cache keeps the result for the training.
    """
    step = Step.of(config, facts)
    state = jax.eval_shape(lambda: step.initial(jax.random.key(0), None, pixels.origins.shape[0]))
    return step.compiled(state, pixels).needed_bytes()


def memory_limit() -> int:
    """Bytes that a step may take on the first device: of its own memory, or of the machine's where it has none."""
    stats = jax.local_devices()[0].memory_stats() or {}
    total = stats.get("bytes_limit") or os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return int(SHARE * total)
