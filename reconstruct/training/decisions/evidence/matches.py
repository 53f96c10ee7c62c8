"""What views of a scene see in common: the evidence for gains, for poses and for matte places."""

import numpy as np

from koala3d.datasets.core.console import progress
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure import matching
from koala3d.datasets.structure.matching import Matches
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.training.decisions.reflection import in_question

VIEWS = 60
"""Views that are compared, at most."""
SIDE = 400
"""Longest side of the images in which views are compared [px]."""


def matches_of(scene: Scene, views: tuple[View, ...], config: Config) -> Matches | None:
    """Matches between neighbouring views, where the configuration leaves something to be decided by them, or begins with it."""
    if config.train.per_image == "none" and config.poses.enabled != "auto" and not in_question(config):
        return None
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, VIEWS).round().astype(int))]
    matrices = np.stack([view.world_from_camera for view in chosen])
    with progress("comparing views", len(chosen), "images") as shown:
        return matching.matched(chosen, matching.pairs_of(matrices, scene.box.mean(0)), side=SIDE, done=shown.advance)
