"""Everything that a training needs before its first step, apart from the run that it leaves."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.console import hint, progress
from koala3d.datasets.imaging.copies import Copies
from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.rendering.probe import Probe
from koala3d.reconstruct.sampling.create import sampler_type
from koala3d.reconstruct.scene import poses
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.pool import Pool
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.scene.reading import held_out, training_pixels
from koala3d.reconstruct.training import distributed
from koala3d.reconstruct.training.batches import Division
from koala3d.reconstruct.training.ray_count import sized
from koala3d.reconstruct.training.skipping import matched, record
from koala3d.reconstruct.training.skipping.evidence import evidence_of
from koala3d.reconstruct.training.skipping.gains import gains_between
from koala3d.reconstruct.training.skipping.lamps import decided_light
from koala3d.reconstruct.training.skipping.matte import matte_share
from koala3d.reconstruct.training.skipping.plan import lenses, plan
from koala3d.reconstruct.training.skipping.refinement import with_poses
from koala3d.reconstruct.training.step import Step, TrainState


class Prepared(NamedTuple):
    """What is there before the first step."""

    step: Step
    """For the configuration as it was decided."""
    state: TrainState
    pixels: Pixels
    probe: Probe | None
    """Pixels of test views; None where there are no such views."""
    held: Pixels | None
    """Pixels of training views that are never trained on, where an early stop is decided by them."""
    pool: Pool | None
    """What renews `pixels`, where they are only a part of all."""
    skips: list[record.Skip]


def prepare(
    scene: Scene,
    config: Config,
    normalisation: Normalisation,
    known: SceneFacts | None = None,
    *,
    fresh: bool = True,
    copies: Copies | None = None,
) -> Prepared:
    """Read the scene's pictures, measure it, decide on the configuration, and make fresh weights.

    Args:
        known: what an earlier training measured, which also decided the model's sizes; None: measure the scene.
        fresh: decide what is left out, and take as many rays per step as there is memory for.
        copies: where large pictures are kept for the next time.
    """
    views = lenses(scene.split("train"), config)
    pixels, pool = training_pixels(views, normalisation, config.scale, copies)
    matches = matched.matches_of(scene, views, config) if fresh else None
    config, refined = with_poses(config, matches, scene, normalisation)
    possible = _possible_cells(config, pixels, pool, views, normalisation)
    skips: list[record.Skip] = []
    facts = known
    if fresh:
        gains = None if matches is None else gains_between(matches)
        stated = (scene.light_frame, scene.light_axis)
        light, lamps = (known.light, None) if known else decided_light(views, pixels, normalisation, possible, config, stated)
        telling = matched.asks_for_matte(config) and normalisation.bounded and not light.moves
        matte = matte_share(matches, scene.box, matched.SIDE) if matches is not None and telling else None
        evidence = evidence_of(scene, views, pixels, normalisation, possible, config.scale, gains, matte)
        lean, skips = plan(evidence, config)
        skips.append(refined)
        if lamps is not None:
            skips.append(lamps)
            if light.moves:
                hint(f"lamps move about the object, light.frame={light.kind}: {lamps.evidence}")
            config, facts = lean, replace(SceneFacts.of(scene, views, normalisation), light=light)
            if gains is not None and config.train.per_image != "none":
                facts = facts.with_gains(gains.log_gains_of(views))
    assert facts is not None, "a training that is not fresh knows its scene"
    held = None
    if config.train.patience:
        pixels, held = held_out(pixels, pool)
    pixels, held = pixels.lit(facts.light, views), held and held.lit(facts.light, views)
    if fresh:
        config = sized(config, facts, pixels)
    config = Config.model_validate_json(distributed.decided_text(config.model_dump_json()))
    step = Step.of(config, facts)
    state = step.initial(jax.random.key(config.train.seed), possible, len(views))
    step = replace(step, division=Division.among(jax.devices(), state.model.sampler.divided_sizes))
    distributed.require_same((state, pixels), "scene")
    if pool is not None:
        pool = replace(pool, rays=state.model.sampler.rays_drawn * config.train.accumulate)
    return Prepared(step, state, pixels, Probe.of(scene, config, normalisation, copies, facts.light), held, pool, skips)


def _possible_cells(
    config: Config, pixels: Pixels, pool: Pool | None, views: tuple[View, ...], normalisation: Normalisation
) -> NDArray[np.bool_] | None:
    """See `Sampler.possible_cells`; from small pictures where there are too many pixels to hold."""
    if pool is not None and normalisation.bounded:
        config = config.model_copy(update={"scale": pool.overview_scale})
        with progress("reading masks", len(views), "images") as shown:
            pixels = Pixels.load(views, normalisation, config.scale, shown)
    slack = poses.slack(config.poses, normalisation)
    return sampler_type(config.sampler).possible_cells(config, pixels, views, normalisation, slack)
