"""Focal length, distortion and principal point against the matches: errors that all views share."""

import numpy as np
from numpy.typing import NDArray

from datasets.checks.evidence import Evidence
from datasets.core.findings import Finding
from datasets.structure.epipolar import Correction, Pairs, corrected

LEAST_PX = 1.0
"""Shift at the middle of the picture's edge from which an error is reported [px of the image that was searched]."""
LEAST_GAIN = 0.955
"""The median distance of right matches must fall to this share of what it was."""
USUAL = 0.5
"""The correction must make this share of all matches right ones: else something other than intrinsics is wrong."""
NAMES = ("focal length", "distortion", "principal point")


def find(evidence: Evidence) -> list[Finding]:
    """One finding where a common change of all cameras makes the matches agree clearly better."""
    name, change, fit = best(evidence)
    shift = float(np.linalg.norm(shifts(change, evidence)))
    certain = bool((np.abs(fit.change) > 5 * fit.std).any())
    few = fit.inliers < max(150, USUAL * len(evidence.pairs.first))
    if few or not certain or shift < LEAST_PX or fit.after_px > LEAST_GAIN * fit.before_px:
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


def best(evidence: Evidence) -> tuple[str, NDArray[np.float64], Correction]:
    """The one correction that helps most: its name, the (4,) change of (log focal length, k1, principal point x and y in px) that
    all views share, and its fit. One at a time, since where few matches lie far from the axis several together cancel."""
    pairs, matrices = evidence.pairs, evidence.matrices
    half, pixel = edge(evidence), float(np.median(pairs.pixel))
    steps = np.array([pixel / half, pixel / half**3, 1.0, 1.0])

    def distances(change: NDArray[np.float64]) -> NDArray[np.float64]:
        a, b = (bent(rays, change, pairs.pixel[:, None]) for rays in (pairs.a, pairs.b))
        size = pairs.pixel * np.exp(-change[0])  # with a longer lens a pixel is a smaller angle
        return Pairs(pairs.first, pairs.second, a, b, size).distances(matrices)

    found = []
    for name, rows in zip(NAMES, ([0], [1], [2, 3]), strict=True):
        fit = corrected(lambda some, rows=rows: distances(_at(rows, some)), steps[rows].tolist())
        found.append((name, _at(rows, fit.change), fit))
    return min(found, key=lambda one: one[2].after_px / max(one[2].inliers, 1))


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
