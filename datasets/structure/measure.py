"""Bounds measured in the images: features are matched between views and triangulated with the known poses.

For scenes without surface points and without masks, whose camera poses alone do not tell how near the nearest object is. It takes
some seconds: `datasets build` does it for recordings, other readers on request only.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.progress import Count, Step, ignore
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, Sightings, View
from koala3d.datasets.splits import evenly
from koala3d.datasets.structure import bounds, matching
from koala3d.datasets.structure.matching import Matches
from koala3d.datasets.structure.triangulate import DOUBTFUL, Cloud, agreement, endless_share, triangulate

VIEWS = 48
"""Largest number of views that are searched."""
SHRINK = (2, 4)
"""Factors by which images are shrunk, one after the other, until enough points are found: smaller images have less noise."""
ENDLESS = 0.01
"""Share of matches with parallel rays from which the background is open and far infinite."""


def measured(scene: Scene, *, views_used: int = VIEWS, done: Count = ignore) -> Scene:
    """The scene with box, near, far and points measured in its images; `bounds_from` names the evidence.

    Where masks or an alpha separate the object, box, near and far already come from the visual hull and only points are added.
    Where too few points can be triangulated, nothing changes and `bounds_from` says so. `done` is called with the number of views
    searched and their total.

    Raises:
        DatasetError: an image is missing, damaged or of the wrong size.
    """
    train = tuple(view for view in scene.views if view.split == "train") or scene.views
    views = evenly(train, views_used)
    matrices = np.stack([view.world_from_camera for view in views])
    centre = bounds.middle(matrices, scene.box)
    searched = iter(range(1, len(views) + 1))
    matches, cloud, found = _placed(views, matrices, centre, lambda: done(next(searched), len(views)))
    placed = f"{len(cloud.points)} points triangulated from {len(views)} views"
    if found is None:
        return replace(scene, bounds_from=f"{scene.bounds_from}; only {placed}, too few")
    agreed = agreement(matches, matrices)
    doubt = f"; the poses explain only {100 * agreed:.0f}% of the matches, see 'datasets check'" if agreed < DOUBTFUL else ""
    evidence = f"{placed} (median error {np.median(cloud.errors_px):.2f} px{doubt})"
    if scene.background == "white":
        return with_cloud(replace(scene, bounds_from=f"{scene.bounds_from}; {evidence}"), matches, cloud)
    box, near, far = found
    if np.isfinite(scene.far):  # stated in the file
        near, far = scene.near, scene.far
    else:
        distance = float(np.median(np.linalg.norm(matrices[:, :3, 3] - centre, axis=1)))
        share = endless_share(matches, matrices, 0.1 * distance)
        if share > ENDLESS:
            far = np.inf
            evidence += f", {100 * share:.1f}% of the matches without parallax: far away"
    return with_cloud(replace(scene, box=box, near=near, far=far, bounds_from=evidence), matches, cloud)


def with_cloud(scene: Scene, matches: Matches, cloud: Cloud) -> Scene:
    """The scene with triangulated points, their colours, and the pixels of the views that saw them.

    The colour of a point is the mean light of its features.
    """
    point, view = cloud.sightings.T
    light, pixels = np.zeros((len(point), 3)), np.zeros((len(point), 2))
    for number, features in enumerate(matches.features):
        rows = np.flatnonzero(view == number)
        light[rows] = features.colours[cloud.features[rows]]
        pixels[rows] = matches.views[number].camera.project(features.directions[cloud.features[rows]])
    total = np.zeros((len(cloud.points), 3))
    np.add.at(total, point, light)
    mean = total / np.bincount(point, minlength=len(total))[:, None]
    seen = Sightings(tuple(view.name for view in matches.views), cloud.sightings, pixels)
    return replace(scene, points=cloud.points, colours=images.to_uint8(images.srgb_from_linear(mean)), sightings=seen)


def _placed(
    views: tuple[View, ...], matrices: NDArray[np.float64], centre: NDArray[np.float64], done: Step
) -> tuple[Matches, Cloud, tuple[bounds.Box, float, float] | None]:
    """Matches, points and bounds from the largest images with enough points; None for bounds where there are too few in all."""
    pairs = matching.neighbours(matrices, centre)
    side = min(matching.SIDE, max(max(view.camera.width, view.camera.height) for view in views))

    def searched(side: int, done: Step) -> tuple[Matches, Cloud, tuple[bounds.Box, float, float] | None]:
        matches = matching.matched(views, pairs, side=side, done=done)
        cloud = triangulate(matches, matrices)
        return matches, cloud, bounds.about_points(views, cloud.points)

    found = searched(side, done)
    for shrink in SHRINK:
        if found[2] is None:
            found = searched(side // shrink, ignore)
    return found
