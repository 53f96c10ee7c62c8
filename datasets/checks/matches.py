"""Poses compared with the images: features matched between neighbouring views, independent of the poses.

Poses are often stored in the wrong convention: the one that explains most matches is probably the right one. Where the given
poses are right, single views that contradict their neighbours are reported, and views brighter or darker than their neighbours.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from datasets import pose
from datasets.conventions import OPENCV_FROM_LLFF, OPENCV_FROM_OPENGL
from datasets.core.errors import KoalaError
from datasets.core.findings import Finding
from datasets.scene import Scene
from datasets.structure import bounds, matching
from datasets.structure.matching import Matches
from datasets.structure.triangulate import DOUBTFUL, agreement, explained

VIEWS = 40
"""Largest number of views that are matched."""
FEWEST = 150
"""With fewer matches, poses are not judged."""
CLEARLY = 0.1
"""Another convention must explain twice as many matches, and more by this share of all."""
USUAL = 0.6
"""Median share of explained matches above which single views are judged."""
BRIGHTER = 1.5
"""Brightness ratio to the neighbours from which a view is reported; shiny objects alone reach 1.3."""

CONVENTIONS: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "OpenGL camera axes (y up, z back) taken for OpenCV's": lambda m: m @ OPENCV_FROM_OPENGL,
    "camera_from_world taken for world_from_camera": pose.inverse,
    "camera_from_world with OpenGL axes taken for world_from_camera": lambda m: pose.inverse(OPENCV_FROM_OPENGL @ m),
    "LLFF's axes (down, right, back) taken for OpenCV's": lambda m: m @ OPENCV_FROM_LLFF,
    "LLFF's axes taken for OpenGL's": lambda m: m @ OPENCV_FROM_OPENGL @ OPENCV_FROM_LLFF,
    "rotations transposed": lambda m: pose.rigid(np.swapaxes(m[..., :3, :3], -1, -2), m[..., :3, 3]),
}
"""Common mistakes, and the correction of each."""


def check_matches(scene: Scene, *, views_used: int = VIEWS) -> list[Finding]:
    """Findings on axis convention, single poses and exposure; none where too little can be matched."""
    views = [scene.views[i] for i in np.unique(np.linspace(0, len(scene.views) - 1, views_used).round().astype(int))]
    matrices = np.stack([view.world_from_camera for view in views])
    centre, spread = bounds.focus(matrices)
    centre = centre if spread > bounds.PARALLEL else scene.box.mean(0)
    in_order = [(i, i + step) for step in (1, 2) for i in range(len(views) - step)]
    pairs = sorted({*matching.neighbours(matrices, centre, count=4), *in_order})
    try:
        matches = matching.matched(views, pairs)
    except KoalaError:
        return []  # an unreadable image is a finding of its own
    if matches.count < FEWEST:
        return []
    found = _convention(scene, matches, matrices)
    return found or [*_single_poses(matches, matrices), *_exposure(matches, matrices)]


def _convention(scene: Scene, matches: Matches, matrices: NDArray[np.float64]) -> list[Finding]:
    given = agreement(matches, matrices)
    others = {name: agreement(matches, change(matrices)) for name, change in CONVENTIONS.items()}
    best = max(others, key=lambda name: others[name])
    shares = f"{100 * given:.0f}% of {matches.count} matches agree with the poses"
    if others[best] > max(given + CLEARLY, 2 * given):
        why = f"{shares}, {100 * others[best]:.0f}% after correcting: {best}"
        return [Finding("error", "poses follow another convention", scene.name, why, "convert the poses where they are written")]
    if given < DOUBTFUL:
        remedy = "check poses, intrinsics and the order of images"
        return [Finding("warning", "poses do not explain the pictures", scene.name, shares, remedy)]
    return []


def _single_poses(matches: Matches, matrices: NDArray[np.float64]) -> list[Finding]:
    """Views whose poses contradict their matches, while those of most other views agree."""
    count, agreed = np.zeros(len(matches.views)), np.zeros(len(matches.views))
    for pair in matches.pairs:
        good = int(explained(matches, pair, matrices).sum())
        for view in pair[:2]:
            count[view] += len(pair[2])
            agreed[view] += good
    share = agreed / np.maximum(count, 1)
    usual = float(np.median(share[count > 0]))
    found = []
    for i in np.flatnonzero((count >= 60) & (share < DOUBTFUL) & (usual > USUAL)):
        why = f"{100 * share[i]:.0f}% of {count[i]:.0f} matches agree, usually {100 * usual:.0f}%"
        where, remedy = f"view {matches.views[i].name}", "check its pose, or drop it"
        found.append(Finding("warning", "pose does not fit the neighbours' pictures", where, why, remedy))
    return found


def _exposure(matches: Matches, matrices: NDArray[np.float64]) -> list[Finding]:
    """Views brighter or darker than their neighbours, by the linear light of points that both see.

    One log gain per view, a least-squares fit to the median log ratios of all pairs.
    """
    rows, ratios, weights = [], [], []
    for pair in matches.pairs:
        i, j, index = pair
        good = index[explained(matches, pair, matrices)]
        light_i, light_j = matches.features[i].light[good[:, 0]], matches.features[j].light[good[:, 1]]
        lit = (light_i > 0.01) & (light_j > 0.01) & (light_i < 0.9) & (light_j < 0.9)  # neither black nor clipped
        if lit.sum() >= 10:
            row = np.zeros(len(matches.views))
            row[i], row[j] = 1.0, -1.0
            rows.append(row)
            ratios.append(float(np.median(np.log(light_i[lit] / light_j[lit]))))
            weights.append(np.sqrt(lit.sum()))
    if len(rows) < len(matches.views) / 2:
        return []
    system, weight = np.array(rows), np.array(weights)
    gains = np.linalg.lstsq(system * weight[:, None], np.array(ratios) * weight, rcond=1e-9)[0]
    known = np.abs(system).sum(0) > 0
    gains = np.exp(gains - np.median(gains[known]))
    deviating = np.flatnonzero(known & (np.maximum(gains, 1 / gains) > BRIGHTER))
    if not len(deviating):
        return []
    worst = deviating[np.argsort(-np.abs(np.log(gains[deviating])))][:5]
    why = "light compared with the median view: " + ", ".join(f"{matches.views[i].name}: {gains[i]:.2f}" for i in worst)
    what = "the same points are not equally bright in all views: exposure drifts, or the light moves"
    remedy = "fix exposure, gain and white balance while recording, or drop these views"
    return [Finding("warning", what, f"{len(deviating)} of {int(known.sum())} views", why, remedy)]
