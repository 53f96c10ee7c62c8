"""Everything that a training needs before its first step, apart from the run that it leaves."""

from typing import NamedTuple

import jax
import numpy as np

from datasets.core.console import progress
from datasets.scene import Scene, View
from reconstruct.config import Config
from reconstruct.models import merged_config
from reconstruct.sampling import focus
from reconstruct.sampling.hull import cells_in_masks, cells_in_sight
from reconstruct.scene import poses
from reconstruct.scene.rays import Normalisation, Pixels, direction_of_cameras
from reconstruct.training import distributed
from reconstruct.training.batch import fitted
from reconstruct.training.skipping import record
from reconstruct.training.skipping.facts import facts_of
from reconstruct.training.skipping.pilot import gain_by_reflecting
from reconstruct.training.skipping.plan import lenses, plan
from reconstruct.training.step import StepFunctions, TrainState

PROBE = 4096
"""Pixels of unseen views that each look renders; never trained on, not on the training's clock."""


class Prepared(NamedTuple):
    """What is there before the first step."""

    functions: StepFunctions
    """With the configuration as it was decided."""
    state: TrainState
    pixels: Pixels
    probe: tuple[np.ndarray, ...] | None
    """Pixels of test views: (origins, directions, radii, colour over white); None where there are no such views."""
    held: Pixels | None
    """Pixels of training views that are never trained on, where an early stop is to be decided by them."""
    skips: list[record.Skip]


def prepare(
    scene: Scene, config: Config, normalisation: Normalisation, *, fresh: bool = False, planned: bool = False
) -> Prepared:
    """Read the scene's pictures, decide on the configuration, and make fresh weights.

    Args:
        fresh: decide what is left out, and take as many rays per step as there is memory for.
        planned: the model's sizes were decided by an earlier training already.
    """
    views = lenses(scene.split("train"), config)
    with progress("reading images", len(views), "images") as shown:
        pixels = Pixels.load(views, normalisation, config.scale, shown)
    possible = None
    if config.sampler.kind == "occupancy" and config.skip.empty_rays:
        if normalisation.bounded:
            slack = poses.slack(config.poses, normalisation)
            possible = cells_in_masks(pixels, views, normalisation, config.sampler.grid, config.scale, slack=slack)
        else:
            possible = cells_in_sight(views, normalisation, config.sampler.outer_grid)
    skips: list[record.Skip] = []
    if fresh:
        facts = facts_of(scene, views, pixels, normalisation, possible, config.scale)
        lean, skips = plan(facts, config, lambda: gain_by_reflecting(config, normalisation, pixels, possible))
        config = config if planned else for_scene(lean, scene, views, normalisation)
    held = None
    if config.train.patience:
        pixels, held = pixels.held_out(PROBE)
    if fresh and config.sampler.kind == "proposal":
        config = fitted(config, normalisation, pixels)
    config = Config.model_validate_json(distributed.decided_text(config.model_dump_json()))
    functions = StepFunctions(config, normalisation).over(jax.devices())
    state = functions.initial(jax.random.key(config.train.seed), possible, len(views))
    distributed.require_same((state, pixels), "scene")
    return Prepared(functions, state, pixels, _probe(scene, config, normalisation), held, skips)


def for_scene(config: Config, scene: Scene, views: tuple[View, ...], normalisation: Normalisation) -> Config:
    """The configuration with what is known of the scene before training, where it does not say otherwise: from where the views
    look, how large the box is around which there is something else, and whether rays that meet this box are to be preferred."""
    field: dict[str, tuple[float, float, float]] = {}
    sampler: dict[str, int] = {}
    if config.field.outward and config.field.towards is None:
        field["towards"] = direction_of_cameras(views, normalisation)
    if config.field.half_box is None and not normalisation.bounded:
        x, y, z = (np.diff(scene.box, axis=0)[0] / 2 * normalisation.scale).tolist()
        field["half_box"] = (x, y, z)
    if config.sampler.candidates is None and not normalisation.bounded:
        sampler["candidates"] = focus.CANDIDATES if scene.box_is_stated else 1
    return merged_config(config, {"field": field, "sampler": sampler})


def _probe(scene: Scene, config: Config, normalisation: Normalisation) -> tuple[np.ndarray, ...] | None:
    """Random pixels of a few test views: (origins, directions, radii, colour over white)."""
    views = [view for view in scene.views if view.split == "test"]
    if not views:
        return None
    views = tuple(views[:: max(1, len(views) // 4)][:4])
    with progress("reading unseen pixels", len(views), "images") as shown:
        pixels = Pixels.load(views, normalisation, config.scale, shown)
    index = np.random.default_rng(0).choice(pixels.directions.shape[0], min(PROBE, pixels.directions.shape[0]), replace=False)
    return pixels.over_white(index)
