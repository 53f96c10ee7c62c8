"""The pose of each view against its neighbours' pictures."""

import numpy as np
from numpy.typing import NDArray

from datasets import pose
from datasets.checks.evidence import Evidence, outstanding
from datasets.core.findings import Finding
from datasets.structure.epipolar import corrected
from datasets.structure.triangulate import DOUBTFUL, explained

LEAST_PX, EVERYWHERE_PX = 0.7, 2.0
"""Shift of the picture from which a pose is reported, for a view that stands out and for the median of all views."""
LEAST_GAIN = 0.55
"""A better pose must reduce the median distance of right matches to this share of what it was."""
FEWEST = 50
"""Right matches with which a view is judged."""
USUAL = 0.6
"""Median share of explained matches above which single views are judged by theirs."""
REMEDY = "check its pose, drop it, or let training refine poses: --set poses.enabled=true"


def find(evidence: Evidence) -> list[Finding]:
    """Views whose pose contradicts their matches, and poses that are wrong everywhere."""
    moved, before, after, share = (np.full(len(evidence.views), np.nan) for _ in range(4))
    for view in range(len(evidence.views)):
        moved[view], before[view], after[view] = offset(evidence, view)
        share[view] = agreed(evidence, view)
    if not np.isfinite(share).any():
        return []
    lost = (share < DOUBTFUL) & (np.nanmedian(share) > USUAL)
    better = after < LEAST_GAIN * before
    found = []
    if np.isfinite(moved).any() and np.nanmedian(np.where(better, moved, 0.0)) > EVERYWHERE_PX:
        why = f"moving each by {np.nanmedian(moved):.1f} px (median) makes it agree with its neighbours"
        remedy = "let training refine poses: --set poses.enabled=true, or run structure from motion again"
        return [Finding("warning", "poses are inaccurate", "all views", why, remedy, "pose", {"median_px": np.nanmedian(moved)})]
    for view in np.flatnonzero(lost | (outstanding(moved, LEAST_PX) & better)):
        name = evidence.views[view].name
        why = f"{100 * share[view]:.0f}% of its matches agree, usually {100 * np.nanmedian(share):.0f}%"
        if not lost[view]:
            why = f"a pose that moves its picture by {moved[view]:.1f} px reduces the distance of its matches from "
            why += f"{before[view]:.2f} to {after[view]:.2f} px; others move by {np.nanmedian(moved):.1f} px"
        what = "pose does not fit the neighbours' pictures"
        found.append(Finding("warning", what, f"view {name}", why, REMEDY, "pose", {"views": {name: float(moved[view])}}))
    return found


def agreed(evidence: Evidence, view: int) -> float:
    """Share of a view's matches that its pose explains; NaN where it has few."""
    of_view = [pair for pair in evidence.matches.pairs if view in pair[:2]]
    count = sum(len(pair[2]) for pair in of_view)
    good = sum(int(explained(evidence.matches, pair, evidence.matrices).sum()) for pair in of_view)
    return good / count if count >= FEWEST else np.nan


def offset(evidence: Evidence, view: int) -> tuple[float, float, float]:
    """How far the best pose of a view moves its picture [px], and the median distance of its matches before and after; NaN where
    matches are few."""
    pairs, matrices = evidence.pairs.of_view(view), evidence.matrices
    if len(pairs.first) < FEWEST:
        return np.nan, np.nan, np.nan
    depth, pixel = evidence.depth(view), float(np.median(pairs.pixel))

    def distances(change: NDArray[np.float64]) -> NDArray[np.float64]:
        turned = matrices.copy()
        turned[view] = matrices[view] @ pose.from_rotation_vector(change[:3], change[3:])
        return pairs.distances(turned)

    fit = corrected(distances, [pixel] * 3 + [pixel * depth] * 3, damping=0.01)
    if fit.inliers < FEWEST:
        return np.nan, np.nan, np.nan
    rays = evidence.matches.features[view].directions * depth
    move = pose.from_rotation_vector(fit.change[:3], fit.change[3:])
    there = (rays - move[:3, 3]) @ move[:3, :3]
    ahead = there[:, 2] > 0.1 * depth
    shift = np.linalg.norm(there[ahead, :2] / there[ahead, 2:] - rays[ahead, :2] / depth, axis=1)
    return float(np.median(shift)) / pixel if len(shift) else np.nan, fit.before_px, fit.after_px
