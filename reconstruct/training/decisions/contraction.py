"""Whether surroundings are contracted: not if all cameras look the same way, at no stated box. Their frustum takes its place."""

from dataclasses import replace

import numpy as np

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.scene.frustum import frustum_of
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.decisions.skip import Skip

NAME, WHAT = "contraction", "space where no camera looks"
SAVING = "resolution where no camera looks; steps in front and behind"


def normalised(found: Normalisation, scene: Scene, config: Config) -> Normalisation:
    """The normalisation with the cameras' common frustum, if there is one."""
    if found.bounded or scene.box_is_stated or not config.skip.contraction:
        return found
    views = scene.split("train")
    return replace(found, frustum=frustum_of(views, found.centre, found.scale, found.near, found.far))


def decided(normalisation: Normalisation, config: Config) -> Skip:
    """The decision that `normalised` made."""
    if normalisation.frustum is not None:
        angle = np.rad2deg(np.arctan(normalisation.frustum.across))
        return Skip(NAME, WHAT, True, f"all cameras look the same way: {angle:.0f} deg hold all that they see", SAVING)
    if normalisation.bounded:
        evidence = "there are no surroundings"
    else:
        evidence = "cameras look different ways, or at a stated box" if config.skip.contraction else "forced"
    return Skip(NAME, WHAT, False, evidence, SAVING)
