"""Everything that a training needs before its first step, apart from the run that it leaves."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from datasets.core.console import hint, progress
from datasets.scene import Scene
from reconstruct.config import Config
from reconstruct.sampling.create import sampler_type
from reconstruct.scene import poses
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.rays import Normalisation, Pixels
from reconstruct.training import distributed
from reconstruct.training.batches import Division
from reconstruct.training.ray_count import fitted
from reconstruct.training.skipping import record
from reconstruct.training.skipping.evidence import evidence_of
from reconstruct.training.skipping.lamps import decided_light
from reconstruct.training.skipping.pilot import gain_by_reflecting
from reconstruct.training.skipping.plan import lenses, plan
from reconstruct.training.step import Step, TrainState

PROBE = 4096
"""Pixels of test views that each line of the log measures; never trained on, and not part of the training's time."""


class Prepared(NamedTuple):
    """What is there before the first step."""

    step: Step
    """For the configuration as it was decided."""
    state: TrainState
    pixels: Pixels
    probe: tuple[Any, ...] | None
    """Pixels of test views, see `Pixels.over_white`; None where there are no such views."""
    held: Pixels | None
    """Pixels of training views that are never trained on, where an early stop is decided by them."""
    skips: list[record.Skip]


def prepare(
    scene: Scene, config: Config, normalisation: Normalisation, known: SceneFacts | None = None, *, fresh: bool = True
) -> Prepared:
    """Read the scene's pictures, measure it, decide on the configuration, and make fresh weights.

    Args:
        known: what an earlier training measured, which also decided the model's sizes; None: measure the scene.
        fresh: decide what is left out, and take as many rays per step as there is memory for.
    """
    views = lenses(scene.split("train"), config)
    with progress("reading images", len(views), "images") as shown:
        pixels = Pixels.load(views, normalisation, config.scale, shown)
    kind = sampler_type(config.sampler)
    possible = kind.possible_cells(config, pixels, views, normalisation, poses.slack(config.poses, normalisation))
    skips: list[record.Skip] = []
    facts = known
    if fresh:
        evidence = evidence_of(scene, views, pixels, normalisation, possible, config.scale)
        lean, skips = plan(evidence, config, lambda: gain_by_reflecting(config, normalisation, pixels, possible))
        if known is None:
            light, skip = decided_light(views, pixels, normalisation, possible, config)
            skips.append(skip)
            if light.moves:
                hint(f"lamps move about the object ({skip.evidence}): light.frame={light.kind}")
            config, facts = lean, SceneFacts.of(scene, views, normalisation, evidence.volume, light)
    assert facts is not None, "a training that is not fresh knows its scene"
    pixels = pixels.lit(facts.light, views)
    held = None
    if config.train.patience:
        pixels, held = pixels.held_out(PROBE)
    if fresh and kind.memory_grows_with_rays:
        config = fitted(config, facts, pixels)
    config = Config.model_validate_json(distributed.decided_text(config.model_dump_json()))
    step = Step.of(config, facts)
    state = step.initial(jax.random.key(config.train.seed), possible, len(views))
    step = replace(step, division=Division.among(jax.devices(), state.model.sampler.divided_sizes))
    distributed.require_same((state, pixels), "scene")
    return Prepared(step, state, pixels, _probe(scene, config, facts), held, skips)


def _probe(scene: Scene, config: Config, facts: SceneFacts) -> tuple[Any, ...] | None:
    """Random pixels of a few test views, see `Pixels.over_white`."""
    views = [view for view in scene.views if view.split == "test"]
    if not views:
        return None
    views = tuple(views[:: max(1, len(views) // 4)][:4])
    with progress("reading unseen pixels", len(views), "images") as shown:
        pixels = Pixels.load(views, facts.normalisation, config.scale, shown).lit(facts.light, views)
    index = np.random.default_rng(0).choice(pixels.directions.shape[0], min(PROBE, pixels.directions.shape[0]), replace=False)
    return pixels.over_white(index)
