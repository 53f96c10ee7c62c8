"""Regions that too few training views see: directions from which the next training view is far away."""

import numpy as np

from koala3d.datasets.core.findings import Finding
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure import bounds

APART_DEG, SPARSE_DEG = 25.0, 40.0
"""Least angle to the nearest other training view from which a view stands alone, and the same for the median of all."""
TIMES = 2.2
"""It must be this many times the usual angle."""


def find(scene: Scene) -> list[Finding]:
    """One finding on views that stand alone, or that all views are too far apart."""
    train = [view for view in scene.views if view.split == "train"]
    if len(train) < 3:
        return []
    matrices = np.stack([view.world_from_camera for view in scene.views])
    outward = matrices[:, :3, 3] - bounds.middle(matrices, scene.box)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    trained = np.array([view.split == "train" for view in scene.views])
    apart = np.rad2deg(np.arccos(np.clip(outward @ outward.T, -1, 1)))
    np.fill_diagonal(apart, np.inf)
    nearest = apart[:, trained].min(1)
    usual = float(np.median(nearest))
    remedy = "take more pictures from there: neighbours should be 10 to 20 degrees apart"
    if usual > SPARSE_DEG:
        why = f"the nearest training view is {usual:.0f} degrees away (median)"
        return [Finding("warning", "views are too far apart", "all views", why, remedy, "coverage", {"median_deg": usual})]
    alone = np.flatnonzero(nearest > max(APART_DEG, TIMES * usual))
    if not len(alone):
        return []
    worst = alone[np.argsort(-nearest[alone])]
    listed = ", ".join(f"{scene.views[i].name}: {nearest[i]:.0f}" for i in worst[:5])
    why = f"degrees to the nearest training view: {listed}; usually {usual:.0f}"
    figures = {"views": {scene.views[i].name: float(nearest[i]) for i in worst}}
    return [Finding("warning", "too few views of a region", f"{len(alone)} views", why, remedy, "coverage", figures)]
