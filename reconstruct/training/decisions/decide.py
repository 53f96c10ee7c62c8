"""All decisions on a scene, and the configuration that follows from them: no code after this asks for the kind of scene."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.console import hint
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure.matching import Matches
from koala3d.reconstruct.config import Config, Kind
from koala3d.reconstruct.models import merged_config, of_kinds
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.light import stated
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.training.decisions import (
    contraction,
    dark_start,
    empty_space,
    exposure,
    reflection,
    regularisers,
    surroundings,
)
from koala3d.reconstruct.training.decisions.evidence.agreement import sessions
from koala3d.reconstruct.training.decisions.evidence.gains import gains_between
from koala3d.reconstruct.training.decisions.evidence.matches import SIDE
from koala3d.reconstruct.training.decisions.evidence.matte import matte_share
from koala3d.reconstruct.training.decisions.lamps import decided_light
from koala3d.reconstruct.training.decisions.skip import Skip


class Decided(NamedTuple):
    """What was found out about a scene."""

    config: Config
    """Plain values, without overlays."""
    facts: SceneFacts
    skips: list[Skip]


def normalisation_of(scene: Scene, config: Config) -> Normalisation:
    """How the scene is normalised: without surroundings, or in the cameras' frustum, if that may be."""
    return contraction.normalised(surroundings.normalised(scene, config), scene, config)


def decided(
    scene: Scene,
    pixels: Pixels,
    normalisation: Normalisation,
    possible: NDArray[np.bool_] | None,
    matches: Matches | None,
    config: Config,
) -> Decided:
    """Measure a scene and decide.

    Args:
        pixels: of the training views.
        possible: cells that can hold anything, see `Sampler.possible_cells`.
        matches: between training views; None: not wanted.
    """
    views = scene.split("train")
    light, lamps = decided_light(views, pixels, normalisation, possible, config, stated(scene))
    if light.moves:
        hint(f"lamps move about the object, light.frame={light.kind}: {lamps.evidence}")
    telling = reflection.in_question(config) and normalisation.bounded and not light.moves
    matte = matte_share(matches, scene.box, SIDE) if matches is not None and telling else None
    gains = None if matches is None else gains_between(matches)
    named, shiny = regularisers.decided(normalisation, scene, config), reflection.decided(matte, config)
    session = sessions(light.of_views(views)) if light.kind == "room" else None
    tells = normalisation.bounded and (not light.moves or session is not None) and not shiny.skipped
    dark = dark_start.decided(pixels, possible if tells else None, config, session)
    kinds: list[Kind] = ["blank" if normalisation.bounded else "surroundings"]
    kinds += [kind for kind, skip in (("unnamed", named), ("matte", shiny), ("painted", dark)) if skip.skipped]
    config, gain = exposure.decided(gains, of_kinds(config, kinds))
    if config.field.matter == "solid" and (possible is None or not possible.any() or not normalisation.bounded):
        config = merged_config(config, {"field": {"matter": "fog"}})  # there is no shape to begin with
    facts = replace(SceneFacts.of(scene, views, normalisation), light=light)
    if gains is not None and config.train.per_image != "none":
        facts = facts.with_gains(gains.log_gains_of(views))
    around = surroundings.decided(normalisation, pixels, config), contraction.decided(normalisation, config)
    return Decided(
        config, facts, [*around, empty_space.decided(normalisation, possible, config), named, shiny, dark, gain, lamps]
    )
