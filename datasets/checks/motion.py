"""Things that move: matches that agree with each other but not with the poses."""

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.checks.evidence import Evidence
from koala3d.datasets.core.findings import Finding

FAR_PX = 4.0
"""Distance from the epipolar plane beyond which a match contradicts the poses."""
ALIKE_PX, NEAR = 4.0, 0.12
"""A match belongs to a moving thing if its nearest companions, at most this share of the picture away, predict it this well."""
MOST_OFF = 0.5
"""Share of a pair's matches that may contradict the poses: beyond it, a pose is wrong."""
COMPANIONS = 4
LEAST_SHARE, FEWEST = 0.03, 30
"""Share of all matches, and their number, from which moving things are reported."""


def find(evidence: Evidence) -> list[Finding]:
    """One finding where things move, with the region in each view."""
    count, agreeing = 0, 0
    inside: dict[int, list[NDArray[np.float64]]] = {}
    for i, j, index in evidence.matches.pairs:
        one, other = evidence.matches.features[i], evidence.matches.features[j]
        a, b = one.directions[index[:, 0], :2] / one.pixel, other.directions[index[:, 1], :2] / other.pixel
        rows = (evidence.pairs.first == i) & (evidence.pairs.second == j)
        distance = evidence.distances[rows]
        off = np.flatnonzero(distance > FAR_PX)
        if len(off) > MOST_OFF * len(distance):
            continue  # a wrong pose
        together = off[coherent(a[off], b[off], NEAR * max(evidence.pictures[i].shape[:2]))]
        count += len(together)
        agreeing += int((distance <= FAR_PX).sum())
        for view, places in ((i, a[together]), (j, b[together])):
            inside.setdefault(view, []).append(places)
    share = count / max(count + agreeing, 1)
    if count < FEWEST or share < LEAST_SHARE:
        return []
    regions = {evidence.views[view].name: _region(evidence, view, np.concatenate(parts)) for view, parts in inside.items()}
    regions = {name: region for name, region in regions.items() if region is not None}
    listed = ", ".join(f"{name}: x {r[0]}-{r[2]}, y {r[1]}-{r[3]}" for name, r in list(regions.items())[:3])
    why = f"{100 * share:.0f}% of the matches agree with each other but not with the poses ({listed})"
    remedy = "keep people, shadows and reflections of the room still or out of the pictures, or mask them"
    what = "something moves, or is seen as a reflection"
    figures = {"share": share, "matches": count, "regions": regions}
    return [Finding("warning", what, f"{len(regions)} views", why, remedy, "motion", figures)]


def coherent(a: NDArray[np.float64], b: NDArray[np.float64], reach: float) -> NDArray[np.bool_]:
    """(n,) True for matches from (n, 2) pixels a to b whose nearest companions are carried along by the same similarity."""
    from scipy.spatial import KDTree

    if len(a) <= COMPANIONS:
        return np.zeros(len(a), bool)
    distance, index = map(np.asarray, KDTree(a).query(a, COMPANIONS + 1))
    near, close = index[:, 1:], distance[:, -1] < reach
    p, q = (values[..., 0] + 1j * values[..., 1] for values in (a, b))
    middle_p, middle_q = p[near].mean(1), q[near].mean(1)
    from_p, to_q = p[near] - middle_p[:, None], q[near] - middle_q[:, None]
    turn = (from_p.conj() * to_q).sum(1) / np.maximum((np.abs(from_p) ** 2).sum(1), 1e-12)  # the best similarity
    rest = np.abs(to_q - turn[:, None] * from_p).max(1)
    own = np.abs(q - middle_q - turn * (p - middle_p))
    sized = (np.abs(turn) > 0.4) & (np.abs(turn) < 2.5)
    return close & sized & (rest < ALIKE_PX) & (own < ALIKE_PX)


def _region(evidence: Evidence, view: int, places: NDArray[np.float64]) -> list[int] | None:
    """[left, top, right, bottom] of the middle 80% of places, in pixels of the view's image; None for few."""
    if len(places) < COMPANIONS:
        return None
    camera, pixel = evidence.views[view].camera, evidence.matches.features[view].pixel
    low, high = (np.quantile(places, q, axis=0) * pixel * camera.fx + [camera.cx, camera.cy] for q in (0.1, 0.9))
    return [int(value) for value in (*low, *high)]
