"""Focal length, distortion and principal point against the matches: errors that all views share."""

import numpy as np
from numpy.typing import NDArray

from datasets.checks.evidence import Evidence
from datasets.core.findings import Finding
from datasets.structure.epipolar import Correction, Pairs, corrected

LEAST_PX = 1.2
"""Shift at the middle of the picture's edge from which an error is reported [px of the image that was searched]."""
LEAST_GAIN = 0.9
"""The median distance of right matches must fall to this share of what it was."""
USUAL = 0.35
"""The correction must make this share of all matches right ones: else something other than intrinsics is wrong."""
NAMES = ("focal length", "distortion", "principal point")


def find(evidence: Evidence) -> list[Finding]:
    """One finding where a common change of all cameras makes the matches agree clearly better."""
    fit = fitted(evidence)
    shift = shifts(fit, evidence)
    worst = int(np.argmax(shift))
    certain = abs(fit.change[worst]) > 5 * fit.std[worst] if worst < 2 else True
    if (
        fit.inliers < max(150, USUAL * len(evidence.pairs.first))
        or shift[worst] < LEAST_PX
        or fit.after_px > LEAST_GAIN * fit.before_px
        or not certain
    ):
        return []
    percent = 100 * np.expm1(fit.change[0])
    why = f"with a focal length {percent:+.1f}%, k1 {fit.change[1]:+.3f} and a principal point moved by "
    why += f"({fit.change[2]:+.1f}, {fit.change[3]:+.1f}) px the median distance of {fit.inliers} matches from their "
    why += f"epipolar planes falls from {fit.before_px:.2f} to {fit.after_px:.2f} px"
    figures = {"focal_percent": percent, "k1": fit.change[1], "centre_px": fit.change[2:].tolist(), "edge_px": shift[worst]}
    remedy = "calibrate the camera, or run structure from motion again with its intrinsics free"
    what = f"intrinsics do not fit the pictures: {NAMES[worst]}"
    return [Finding("warning", what, "all views", why, remedy, "intrinsics", figures)]


def without_error(evidence: Evidence) -> Evidence:
    """The evidence with the fitted correction applied to all rays."""
    change = fitted(evidence).change
    rays = [bent(features.directions, change, features.pixel) for features in evidence.matches.features]
    return evidence.with_cameras(rays, evidence.matrices)


def fitted(evidence: Evidence) -> Correction:
    """Change of (log focal length, k1, principal point x and y in px) that all views share."""
    pairs, matrices = evidence.pairs, evidence.matrices

    def distances(change: NDArray[np.float64]) -> NDArray[np.float64]:
        a, b = (bent(rays, change, pairs.pixel[:, None]) for rays in (pairs.a, pairs.b))
        return Pairs(pairs.first, pairs.second, a, b, pairs.pixel).distances(matrices)

    half = edge(evidence)
    pixel = float(np.median(pairs.pixel))
    return corrected(distances, (pixel / half, pixel / half**3, 1.0, 1.0))


def bent(rays: NDArray[np.float64], change: NDArray[np.float64], pixel: float | NDArray) -> NDArray[np.float64]:
    """(n, 3) rays with z = 1 after a change of the intrinsics, to first order in it."""
    flat = (rays[:, :2] - change[2:] * pixel) * np.exp(-change[0])
    radius2 = (flat**2).sum(1, keepdims=True)
    return np.concatenate([flat / (1 + np.clip(change[1] * radius2, -0.5, 1.0)), np.ones((len(rays), 1))], axis=1)


def shifts(fit: Correction, evidence: Evidence) -> NDArray[np.float64]:
    """(3,) what focal length, distortion and principal point move the middle of the picture's edge by [px]."""
    half, pixel = edge(evidence), float(np.median(evidence.pairs.pixel))
    focal, k1, *centre = np.abs(fit.change)
    return np.array([focal * half, k1 * half**3, np.linalg.norm(centre) * pixel]) / pixel


def edge(evidence: Evidence) -> float:
    """Tangent of the angle under which most matches lie: what intrinsics move most among them."""
    return float(np.quantile(np.linalg.norm(evidence.pairs.a[:, :2], axis=1), 0.9))
