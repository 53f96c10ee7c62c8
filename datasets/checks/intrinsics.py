"""Focal length, distortion and principal point against the matches: errors that all views share."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.checks.evidence import Evidence
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.structure.epipolar import CLOSE, WIDTHS, Correction, Pairs, corrected, off_plane

LEAST_PX = 1.0
"""Shift at the middle of the picture's edge from which an error is reported [px of the image that was searched]."""
LEAST_GAIN = 0.003
"""Share of the matches' robust cost that the correction must remove. Untouched scenes reach 0.001."""
MATCHES = 15_000
"""So many of the matches are looked at, drawn at random."""
PARTS = 4
"""Disjoint parts of the pairs of views, each of which must ask for the correction in the same direction."""
USUAL = 0.5
"""The correction must make this share of all matches right ones: else something other than intrinsics is wrong."""
MOST_BENT = 0.35
"""A distortion that moves the outer matches by more than this share of their distance from the middle is no lens. Reflections,
which move over the object as the camera does, can look like one."""
ROWS = {"focal length": [0], "distortion": [1], "principal point": [2, 3]}
"""What may be wrong, and its rows in a change of (log focal length, k1, principal point x and y in px)."""
NAMES = tuple(ROWS)


def find(evidence: Evidence) -> list[Finding]:
    """One finding where a common change of all cameras makes the matches agree clearly better."""
    name, change, fit = best(evidence)
    shift = float(np.linalg.norm(shifts(change, evidence)))
    few = fit.inliers < max(150, USUAL * min(len(evidence.pairs.first), MATCHES))
    pixel = float(np.median(evidence.pairs.pixel))
    if name == "distortion" and shift > MOST_BENT * edge(evidence) / pixel:
        return []
    if few or shift < LEAST_PX or fit.gain < LEAST_GAIN or not _everywhere(evidence, name, change):
        return []
    words = {
        "focal length": f"a focal length {100 * np.expm1(change[0]):+.1f}%",
        "distortion": f"k1 {change[1]:+.3f}",
        "principal point": f"a principal point moved by ({change[2]:+.1f}, {change[3]:+.1f}) px",
    }
    why = f"with {words[name]}, which moves the outer matches by {shift:.1f} px, the median distance of {fit.inliers} matches "
    why += f"from their epipolar lines falls from {fit.before_px:.2f} to {fit.after_px:.2f} px"
    figures = {"change": change.tolist(), "shift_px": shift, "before_px": fit.before_px, "after_px": fit.after_px}
    remedy = "calibrate the camera, or run structure from motion again with its intrinsics free"
    what = f"intrinsics do not fit the pictures: {name}"
    return [Finding("warning", what, "all views", why, remedy, "intrinsics", figures)]


def without_error(evidence: Evidence) -> Evidence:
    """The evidence with the best correction applied to all rays."""
    change = best(evidence)[1]
    rays = [bent(features.directions, change, features.pixel) for features in evidence.matches.features]
    return evidence.with_cameras(rays, evidence.matrices)


@lru_cache(maxsize=1)
def best(evidence: Evidence) -> tuple[str, NDArray[np.float64], Correction]:
    """The one correction that helps most: its name, the (4,) change of (log focal length, k1, principal point x and y in px) that
    all views share, and its fit. One at a time, since where few matches lie far from the axis several together cancel."""
    found, some = [], _drawn(evidence.pairs)
    for name in NAMES:
        fit = _fitted(evidence, name, some)
        found.append((name, _at(ROWS[name], fit.change), fit))
    large = [one for one in found if np.linalg.norm(shifts(one[1], evidence)) >= LEAST_PX]
    return max(large or found, key=lambda one: one[2].gain)


def _fitted(evidence: Evidence, name: str, pairs: Pairs) -> Correction:
    """The best change of one of `NAMES` for some of the matches."""
    half, pixel, rows = edge(evidence), float(np.median(evidence.pairs.pixel)), ROWS[name]
    steps, essential = np.array([pixel / half, pixel / half**3, 1.0, 1.0])[rows], pairs.essential(evidence.matrices)

    def distances(values: NDArray[np.float64]) -> NDArray[np.float64]:
        change = _at(rows, values)
        a, b = (bent(rays, change, pairs.pixel[:, None]) for rays in (pairs.a, pairs.b))
        return off_plane(essential, a, b) / (pairs.pixel * np.exp(-change[0]))  # with a longer lens a pixel is a smaller angle

    return corrected(distances, steps.tolist(), widths=(*WIDTHS, *CLOSE))


def _drawn(pairs: Pairs) -> Pairs:
    count = len(pairs.first)
    return pairs if count <= MATCHES else pairs.at(np.random.default_rng(0).choice(count, MATCHES, replace=False))


def _everywhere(evidence: Evidence, name: str, change: NDArray[np.float64]) -> bool:
    """Whether disjoint parts of the pairs of views all gain by a change in the same direction: else a few of them decide."""
    pairs = _drawn(evidence.pairs)
    part = np.unique(np.stack([pairs.first, pairs.second]), axis=1, return_inverse=True)[1].reshape(-1) % PARTS
    for one in range(PARTS):
        fit = _fitted(evidence, name, pairs.at(np.flatnonzero(part == one)))
        if fit.gain <= 0 or float(_at(ROWS[name], fit.change) @ change) <= 0:
            return False
    return True


def _at(rows: list[int], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) values at `rows`, zero elsewhere."""
    change = np.zeros(4)
    change[rows] = values
    return change


def bent(rays: NDArray[np.float64], change: NDArray[np.float64], pixel: float | NDArray) -> NDArray[np.float64]:
    """(n, 3) rays with z = 1 after a change of the intrinsics, to first order in it."""
    flat = (rays[:, :2] - change[2:] * pixel) * np.exp(-change[0])
    radius2 = (flat**2).sum(1, keepdims=True)
    return np.concatenate([flat / (1 + np.clip(change[1] * radius2, -0.5, 1.0)), np.ones((len(rays), 1))], axis=1)


def shifts(change: NDArray[np.float64], evidence: Evidence) -> NDArray[np.float64]:
    """(3,) what the changes of focal length, distortion and principal point move the outer matches by [px]."""
    half, pixel = edge(evidence), float(np.median(evidence.pairs.pixel))
    return np.array([change[0] * half / pixel, change[1] * half**3 / pixel, np.linalg.norm(change[2:])], np.float64)


def edge(evidence: Evidence) -> float:
    """Tangent of the angle under which most matches lie: what intrinsics move most among them."""
    return float(np.quantile(np.linalg.norm(evidence.pairs.a[:, :2], axis=1), 0.9))
