"""The pose of each view against its neighbours' pictures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.checks.evidence import Evidence
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.structure.epipolar import corrected
from koala3d.datasets.structure.triangulate import DOUBTFUL, agreement, explained

LEAST_PX = 0.65
"""Shift of the picture from which a pose is reported [px of the image that was searched]."""
EVERYWHERE = 0.34
"""Share of wrong poses from which not single ones are wrong but all are inaccurate."""
LEAST_GAIN = 0.5
"""A better pose must reduce the median distance of right matches to this share of what it was."""
FEWEST = 30
"""Right matches with which a view is judged."""
TIMES = 2.5
"""A wrong pose moves its picture by this many times the median of the others."""
USUAL = 0.6
"""Median share of explained matches above which single views are judged by theirs."""
MATCHED = 0.5
"""Matches of such a view, as a share of the usual number: one that shows little that others show too has only wrong ones."""
EXPLAINED = 0.5
"""Share of all matches that the poses explain below which no single pose is judged by how it moves: a few wrong poses leave most
matches explained, reflections do not, and they move in other ways."""
REMEDY = "check its pose, drop it, or let training refine poses: --set poses.enabled=true"
WHAT = "pose does not fit the neighbours' pictures"


@dataclass(frozen=True, eq=False)
class Offset:
    """The best pose of a view against its neighbours, and the one that was given."""

    moved_px: float
    """How far it moves the picture."""
    before_px: float
    after_px: float
    """Median distance of its right matches from their epipolar lines, before and after."""
    matrix: NDArray[np.float64]

    @property
    def better(self) -> bool:
        """Whether it explains the matches clearly better."""
        return self.after_px < LEAST_GAIN * self.before_px


def find(evidence: Evidence) -> list[Finding]:
    """Views whose pose contradicts their matches, and poses that are wrong everywhere."""
    share = np.array([agreed(evidence, view) for view in range(len(evidence.views))])
    if not np.isfinite(share).any():
        return []
    wrong, usual = wrong_poses(evidence)
    count = np.array([len(evidence.pairs.of_view(view).first) for view in range(len(evidence.views))])
    enough = count > MATCHED * np.median(count)
    lost = set(np.flatnonzero((share < DOUBTFUL) & enough & (np.nanmedian(share) > USUAL)).tolist()) - wrong.keys()
    if len(wrong) > EVERYWHERE * len(evidence.views):
        moved = float(np.median([one.moved_px for one in wrong.values()]))
        why = f"{len(wrong)} of {len(evidence.views)} agree better with their neighbours when moved, by {moved:.1f} px (median)"
        remedy = "let training refine poses: --set poses.enabled=true, or run structure from motion again"
        return [Finding("warning", "poses are inaccurate", "all views", why, remedy, "pose", {"median_px": moved})]
    judged = wrong if agreement(evidence.matches, evidence.matrices) > EXPLAINED else {}
    found = []
    for view in sorted(lost | judged.keys()):
        name, size = evidence.views[view].name, np.nan
        why = f"{100 * share[view]:.0f}% of its matches agree, usually {100 * np.nanmedian(share):.0f}%"
        if view in judged:
            one, size = judged[view], judged[view].moved_px
            why = f"a pose that moves its picture by {size:.1f} px reduces the distance of its matches from "
            why += f"{one.before_px:.2f} to {one.after_px:.2f} px; others move by {usual:.1f} px"
        found.append(Finding("warning", WHAT, f"view {name}", why, REMEDY, "pose", {"views": {name: size}}))
    return found


def wrong_poses(evidence: Evidence) -> tuple[dict[int, Offset], float]:
    """Offsets of views that stand out, and the median shift of the others.

    The worst is corrected before its neighbours are judged again, since it made them look wrong too.
    """
    matrices, wrong = evidence.matrices.copy(), {}
    offsets = {view: offset(evidence, view, matrices) for view in range(len(evidence.views))}
    while True:
        rest = np.array([one.moved_px if one else np.nan for view, one in offsets.items() if view not in wrong])
        usual = float(np.nanmedian(rest)) if np.isfinite(rest).any() else 0.0
        known = {view: one for view, one in offsets.items() if one and view not in wrong}
        wild = [view for view, one in known.items() if one.better and one.moved_px > max(LEAST_PX, TIMES * usual)]
        if not wild or len(wrong) > len(evidence.views) / 2:
            return wrong, usual
        worst = max(wild, key=lambda view: known[view].before_px - known[view].after_px)
        wrong[worst] = known[worst]
        matrices[worst] = known[worst].matrix
        for view in {i for pair in evidence.matches.pairs if worst in pair[:2] for i in pair[:2]} - wrong.keys():
            offsets[view] = offset(evidence, view, matrices)


def agreed(evidence: Evidence, view: int) -> float:
    """Share of a view's matches that its pose explains; NaN where it has few."""
    of_view = [pair for pair in evidence.matches.pairs if view in pair[:2]]
    count = sum(len(pair[2]) for pair in of_view)
    good = sum(int(explained(evidence.matches, pair, evidence.matrices).sum()) for pair in of_view)
    return good / count if count >= FEWEST else np.nan


def offset(evidence: Evidence, view: int, matrices: NDArray[np.float64]) -> Offset | None:
    """The best pose of a view among (views, 4, 4) poses; None where right matches are few."""
    pairs = evidence.pairs.of_view(view)
    if len(pairs.first) < FEWEST:
        return None
    depth, pixel = evidence.depth(view), float(np.median(pairs.pixel))

    def distances(change: NDArray[np.float64]) -> NDArray[np.float64]:
        turned = matrices.copy()
        turned[view] = matrices[view] @ pose.from_rotation_vector(change[:3], change[3:])
        return pairs.distances(turned)

    fit = corrected(distances, [pixel] * 3 + [pixel * depth] * 3, damping=0.01)
    if fit.inliers < FEWEST:
        return None
    rays = evidence.matches.features[view].directions * depth
    move = pose.from_rotation_vector(fit.change[:3], fit.change[3:])
    there = (rays - move[:3, 3]) @ move[:3, :3]
    ahead = there[:, 2] > 0.1 * depth
    if not ahead.any():
        return None
    shift = np.linalg.norm(there[ahead, :2] / there[ahead, 2:] - rays[ahead, :2] / depth, axis=1)
    return Offset(float(np.median(shift)) / pixel, fit.before_px, fit.after_px, matrices[view] @ move)
