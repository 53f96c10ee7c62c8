"""The object's box against the points and masks of the pictures."""

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.checks.evidence import Evidence
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.structure import bounds

FEWEST = 60
"""Points with which a box is judged."""
MISSED = 0.25
"""Share of the object's points outside the box from which it is reported."""
TOO_LARGE = 3.0
"""Times by which a box may be longer than what lies in it."""
BLANK = 0.08
"""Share of the outlines of masks that may lie at edges of pictures."""


def find(evidence: Evidence) -> list[Finding]:
    """Findings on a box that misses the object, on one that is far too large, and on an object that leaves the pictures."""
    masked = evidence.scene.background == "white"
    points = evidence.cloud.points if masked else _looked_at(evidence)
    found = _cut(evidence) if masked else []
    if len(points) < FEWEST:
        return found
    low, high = evidence.scene.box
    slack = 0.03 * (high - low)
    missed = float(((points < low - slack) | (points > high + slack)).any(1).mean())
    ends = np.quantile(points, (0.02, 0.98), axis=0)
    figures = {"missed": missed, "points": len(points), "measured_box": ends.tolist()}
    measured = " to ".join(str([float(f"{value:.3g}") for value in corner]) for corner in ends)
    what, where = "box misses a part of what the cameras look at", evidence.scene.name
    if missed > (MISSED if masked else 1 - MISSED):
        why = f"{100 * missed:.0f}% of {len(points)} points lie outside; most of them are within {measured}"
        return [*found, Finding("warning", what, where, why, "state a box that holds them", "box", figures)]
    times = float((high - low).max() / max((ends[1] - ends[0]).max(), 1e-12))
    if masked and times > TOO_LARGE:
        why = f"it is {times:.1f} times as long as what was found in it, {measured}"
        remedy = "state a tighter box: resolution is spent on empty space"
        return [*found, Finding("warning", "box is far too large", where, why, remedy, "box", {**figures, "times": times})]
    return found


def _looked_at(evidence: Evidence) -> NDArray[np.float64]:
    """Points that at least half of the views have in the middle half of their pictures."""
    points = evidence.cloud.points
    count = np.zeros(len(points), int)
    for view in evidence.views:
        camera = view.camera
        depth = bounds.depths_in_picture(view, points)
        local = (points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
        pixels = local[:, :2] / np.where(np.isnan(depth), 1.0, depth)[:, None] * [camera.fx, camera.fy]
        off = np.abs(pixels + np.array([camera.cx - camera.width / 2, camera.cy - camera.height / 2]))
        count += ~np.isnan(depth) & (off < np.array([camera.width, camera.height]) / 4).all(1)
    return points[count >= len(evidence.views) / 2]


def _cut(evidence: Evidence) -> list[Finding]:
    """A finding where masks reach the edges of many pictures."""
    cut = []
    for view, picture in zip(evidence.views, evidence.pictures, strict=True):
        if picture.shape[-1] != 4:
            return []
        inside = picture[..., 3] > 0.5
        border = np.concatenate([inside[0], inside[-1], inside[:, 0], inside[:, -1]])
        if border.mean() > BLANK and not inside.all():
            cut.append(view.name)
    if len(cut) < len(evidence.views) / 3:
        return []
    why = f"its mask reaches the edge of {len(cut)} of {len(evidence.views)} pictures"
    remedy = "take pictures that show all of it, or state a box that holds all of it"
    what = "object leaves the pictures"
    return [Finding("warning", what, f"{len(cut)} views", why, remedy, "box", {"views": dict.fromkeys(cut, 1.0)})]
