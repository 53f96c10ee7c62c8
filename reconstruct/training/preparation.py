"""Everything that a training needs before its first step, apart from the run that it leaves."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.console import progress
from koala3d.datasets.imaging.copies import Copies
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure.masks.silhouette import Slack
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.rendering.probe import Probe
from koala3d.reconstruct.sampling.create import sampler_type
from koala3d.reconstruct.sampling.hull import pixels_on_cells
from koala3d.reconstruct.sampling.hull_distance import hull_distance
from koala3d.reconstruct.scene import poses
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.pool import Pool
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.scene.reading import training_pixels
from koala3d.reconstruct.training import distributed
from koala3d.reconstruct.training.batches import Division
from koala3d.reconstruct.training.capacity import with_rows
from koala3d.reconstruct.training.decisions import poses as pose_decision
from koala3d.reconstruct.training.decisions.decide import decided
from koala3d.reconstruct.training.decisions.evidence.matches import matches_of
from koala3d.reconstruct.training.decisions.skip import Skip
from koala3d.reconstruct.training.ray_count import sized
from koala3d.reconstruct.training.step import Step, TrainState


class Prepared(NamedTuple):
    """What is there before the first step."""

    step: Step
    """For the configuration as it was decided."""
    state: TrainState
    pixels: Pixels
    probe: Probe | None
    """Pixels of test views; None where there are no such views."""
    pool: Pool | None
    """What renews `pixels`, where they are only a part of all."""
    skips: list[Skip]


def prepare(
    scene: Scene,
    config: Config,
    normalisation: Normalisation,
    known: SceneFacts | None = None,
    *,
    fresh: bool = True,
    copies: Copies | None = None,
    budget_s: float | None = None,
) -> Prepared:
    """Read the scene's pictures, measure it, decide on the configuration, and make fresh weights.

    Args:
        known: what an earlier training measured, whose decisions are in `config`; None: measure the scene and decide.
        fresh: take as many rays per step as there is memory for, and decide whether poses are refined.
        copies: where large pictures are kept for the next time.
        budget_s: seconds of training, where they say how long it is; None: the configuration's steps.
    """
    views = scene.split("train")
    pixels, pool = training_pixels(views, normalisation, config.scale, copies)
    matches = matches_of(scene, views, config) if fresh else None
    skips: list[Skip] = []
    session = (
        poses.session_of(scene, normalisation)
        if known is None and pose_decision.corrects_motion(config.poses.enabled, scene)
        else None
    )
    if fresh:
        config, refined = pose_decision.decided(config, matches, scene, normalisation)
        skips.append(refined)
    free = session is not None or (known is not None and known.session is not None)
    slack = poses.slack(config.poses, normalisation, scene, free=free)
    possible = _possible_cells(config, pixels, pool, views, normalisation, slack)
    facts = known
    if facts is None:
        config, facts, others = decided(scene, pixels, normalisation, possible, matches, config)
        facts, skips = replace(facts, session=session), [*others, *skips]
    pixels = pixels.under(facts.light, views)
    whole = pixels
    if pool is None:
        if possible is not None and possible.any() and normalisation.bounded:  # rays that meet nothing learn nothing
            pixels = pixels.chosen(pixels_on_cells(possible, views, normalisation, config.scale))
        pixels = pixels.filled_up()
    if fresh:
        config = sized(with_rows(config, budget_s), facts, pixels)
    config = Config.model_validate_json(distributed.decided_text(config.model_dump_json()))
    step = Step.of(config, facts)
    hull = hull_distance(possible, whole) if possible is not None and config.field.matter == "solid" else None
    state = step.initial(jax.random.key(config.train.seed), possible, len(views), hull)
    step = replace(step, division=Division.among(jax.devices(), state.model.sampler.divided_sizes))
    distributed.require_same((state, pixels), "scene")
    if pool is not None:
        pool = replace(pool, rays=state.model.sampler.rays_drawn)
    return Prepared(step, state, pixels, Probe.of(scene, config, normalisation, copies, facts.light), pool, skips)


def _possible_cells(
    config: Config,
    pixels: Pixels,
    pool: Pool | None,
    views: tuple[View, ...],
    normalisation: Normalisation,
    slack: Sequence[Slack],
) -> NDArray[np.bool_] | None:
    """See `Sampler.possible_cells`; from small pictures where there are too many pixels to hold."""
    if pool is not None and normalisation.bounded:
        config = config.model_copy(update={"scale": pool.overview_scale})
        with progress("reading masks", len(views), "images") as shown:
            pixels = Pixels.load(views, normalisation, config.scale, shown)
    return sampler_type(config.sampler).possible_cells(config, pixels, views, normalisation, slack)
