"""Exposure and white balance of each view against the others."""

import numpy as np

from koala3d.datasets.checks.evidence import OUTSTANDING, Evidence
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.structure.exposure import ExposureGains, exposure_gains

LEAST, CERTAIN = np.log(1.12), np.log(1.5)
"""Log gain from which a view is reported where it stands out from the others, and from which it is reported anyway."""
LEAST_COLOUR = np.log(1.08)
"""The same for one channel against the view's others."""


def find(evidence: Evidence) -> list[Finding]:
    """One finding on exposure and one on white balance, each with the views that differ and all gains."""
    found = exposure_gains(evidence.matches, evidence.matrices)
    if np.isfinite(found.log_gains).all(1).sum() < max(4, len(evidence.views) / 3):
        return []
    return [*_exposure(found), *_white_balance(found)]


def deviating(values: np.ndarray, std: np.ndarray, least: float, certain: float) -> np.ndarray:
    """True for (n,) log values that stand out from the others, or that are certainly far from their median.

    A NaN among `values` or `std` stands for what could not be measured, and is never true.
    """
    known = np.isfinite(values)
    spread = 1.4826 * np.median(np.abs(values[known] - np.median(values[known])))
    size = np.abs(values - np.median(values[known]))
    return known & (size > 4 * std) & ((size > max(least, OUTSTANDING * spread)) | (size > certain))


def _exposure(found: ExposureGains) -> list[Finding]:
    gains, std = found.log_gains.mean(1), found.std.mean(1)
    chosen = np.flatnonzero(deviating(gains, std, LEAST, CERTAIN))
    if not len(chosen):
        return []
    worst = chosen[np.argsort(-np.abs(gains[chosen]))]
    listed = ", ".join(f"{found.names[i]}: {np.exp(gains[i]):.2f}" for i in worst[:5])
    why = f"light compared with the median view: {listed}"
    known = np.flatnonzero(np.isfinite(gains))  # JSON has no NaN for the others
    figures = {
        "views": {found.names[i]: float(np.exp(gains[i])) for i in worst},
        "gains": {found.names[i]: np.exp(found.log_gains[i]).tolist() for i in known},
        "log_std": {found.names[i]: float(std[i]) for i in known if np.isfinite(std[i])},
    }
    what = "the same points are not equally bright in all views: exposure drifts, or the light moves"
    remedy = "fix exposure, gain and white balance while recording, or drop these views; training learns a gain for each view"
    where = f"{len(chosen)} of {int(np.isfinite(gains).sum())} views"
    return [Finding("warning", what, where, why, remedy, "exposure", figures)]


def _white_balance(found: ExposureGains) -> list[Finding]:
    colour, std = np.log(found.white_balance), found.std
    off = np.stack([deviating(colour[:, k], std[:, k], LEAST_COLOUR, np.log(1.25)) for k in range(3)], axis=1)
    chosen = np.flatnonzero(off.any(1))
    if not len(chosen):
        return []
    worst = chosen[np.argsort(-np.abs(colour[chosen]).max(1))]
    listed = ", ".join(f"{found.names[i]}: " + "/".join(f"{g:.2f}" for g in np.exp(colour[i])) for i in worst[:5])
    why = f"red/green/blue compared with the median view, less the common gain: {listed}"
    figures = {"views": {found.names[i]: np.exp(colour[i]).tolist() for i in worst}}
    where = f"{len(chosen)} of {int(np.isfinite(colour).all(1).sum())} views"
    what = "white balance differs between views"
    remedy = "fix the white balance while recording; training learns a gain of each colour for each view"
    return [Finding("warning", what, where, why, remedy, "white balance", figures)]
