"""Bounds measured in the pictures: features are matched between views and triangulated along the known poses.

For scenes that come without surface points and without masks, of which the cameras alone say little: how near the
nearest thing is, for one. Takes some seconds, so it is done only where it is asked for.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from datasets.scene import Scene, View
from datasets.structure import bounds, matching
from datasets.structure.matching import Matches
from datasets.structure.triangulate import DOUBTFUL, Cloud, agreement, endless_share, triangulate

VIEWS = 48
"""Views that are searched at most."""
SHRINK = (1, 2, 4)
"""Where too few points are found, they are sought again in pictures so many times smaller: there noise is averaged away."""
ENDLESS = 0.01
"""Where more than this share of the matches has parallel rays, there is open background: far is infinite."""


def measured(scene: Scene, *, views_used: int = VIEWS, done: Callable[[int, int], None] = lambda count, total: None) -> Scene:
    """The scene with box, near, far and points as its pictures show them, and `bounds_from` saying on what evidence.

    Where masks or an alpha tell the object from nothing, box, near and far are the visual hull's already and stay; only
    the points are added. Where too little can be triangulated, everything stays, and `bounds_from` says so. `done` is
    called with the number of views searched and of all.

    Raises:
        DatasetError: an image is missing, damaged or of the wrong size.
    """
    train = tuple(view for view in scene.views if view.split == "train") or scene.views
    views = tuple(train[i] for i in np.unique(np.linspace(0, len(train) - 1, views_used).round().astype(int)))
    matrices = np.stack([view.world_from_camera for view in views])
    centre, spread = bounds.focus(matrices)
    if spread < bounds.PARALLEL:  # the axes have no common point: any depth among those seen will do
        centre = scene.box.mean(0)
    searched = iter(range(1, len(views) + 1))
    matches, cloud, found = _placed(views, matrices, centre, lambda: done(next(searched), len(views)))
    seen = f"{len(cloud.points)} points triangulated from {len(views)} views"
    if found is None:
        return replace(scene, bounds_from=f"{scene.bounds_from}; only {seen}, too few to measure by")
    agreed = agreement(matches, matrices)
    doubt = f"; the poses explain only {100 * agreed:.0f}% of the matches, see 'datasets check'" if agreed < DOUBTFUL else ""
    evidence = f"{seen} (median error {np.median(cloud.errors_px):.2f} px{doubt})"
    if scene.background == "white":
        return replace(scene, points=cloud.points, bounds_from=f"{scene.bounds_from}; {evidence}")
    box, near, far = found
    if np.isfinite(scene.far):  # stated by the file
        near, far = scene.near, scene.far
    else:
        distance = float(np.median(np.linalg.norm(matrices[:, :3, 3] - centre, axis=1)))
        share = endless_share(matches, matrices, 0.1 * distance)
        if share > ENDLESS:
            far = np.inf
            evidence += f", {100 * share:.1f}% of the matches without parallax: far away"
    return replace(scene, box=box, near=near, far=far, points=cloud.points, bounds_from=evidence)


def _placed(
    views: tuple[View, ...], matrices: NDArray[np.float64], centre: NDArray[np.float64], done: Callable[[], None]
) -> tuple[Matches, Cloud, tuple[bounds.Box, float, float] | None]:
    """Matches, points and bounds in the largest pictures that give enough of them; without bounds, in the smallest."""
    pairs = matching.neighbours(matrices, centre)
    side = min(matching.SIDE, max(max(view.camera.width, view.camera.height) for view in views))
    for shrink in SHRINK:
        matches = matching.matched(views, pairs, side=side // shrink, done=done if shrink == 1 else lambda: None)
        cloud = triangulate(matches, matrices)
        found = bounds.about_points(views, cloud.points)
        if found is not None:
            break
    return matches, cloud, found
