"""Views that are blurred compared with their neighbours, by motion or focus.

Fine against coarse contrast around the same points does not depend on exposure. What a known blur does to it, measured on the
sharpest pictures, turns it into pixels.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.checks.evidence import OUTSTANDING, Evidence
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.structure import matching
from koala3d.datasets.structure.relative import robust_median, values_of_views

FINE_PX, COARSE_PX, WINDOW_PX = 0.6, 2.4, 5.0
"""Scales of the contrast, and of the window around a point [px of the image that was searched]."""
BLURS_PX = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0)
LEAST_PX = 0.8
FEWEST_PAIRS = 3
"""Neighbours with which a view is compared at least."""
ZOOM = 1.35
"""Pictures whose scales differ by more are not compared."""
FEWEST = 12
"""Points with which a pair of views is compared."""


def find(evidence: Evidence) -> list[Finding]:
    """One finding per view that is blurrier than its neighbours."""
    values, std = sharpness(evidence)
    values = against_neighbours(evidence, values)
    known = np.isfinite(values)
    if known.sum() < 4:
        return []
    spread = 1.4826 * float(np.median(np.abs(values[known])))
    lost = known & (-values > OUTSTANDING * spread) & (-values > 4 * std)
    sigma = equivalent(evidence, values)
    found = []
    for view in np.flatnonzero(lost & (sigma > LEAST_PX)):
        name = evidence.views[view].name
        why = f"around the points that its neighbours see too it is as blurred as after a Gaussian of {sigma[view]:.1f} px "
        why += f"(at {max(evidence.pictures[view].shape[:2])} px a side)"
        remedy = "take it again with the camera at rest and in focus, or drop it"
        figures = {"views": {name: float(sigma[view])}}
        found.append(Finding("warning", "picture is blurred", f"view {name}", why, remedy, "blur", figures))
    return found


def sharpness(evidence: Evidence) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(views,) log of fine against coarse contrast relative to the median view, and its standard deviation."""
    maps = [contrast(grey(picture)) for picture in evidence.pictures]
    points = [evidence.cloud.sightings[evidence.cloud.sightings[:, 1] == view, 0] for view in range(len(maps))]
    pairs, differences, std = [], [], []
    zoom = [1 / (evidence.depth(view) * evidence.matches.features[view].pixel) for view in range(len(maps))]
    for i, j in matching.pairs_of(evidence.matrices, evidence.focus):  # also where blur leaves no matches
        if max(zoom[i], zoom[j]) > ZOOM * min(zoom[i], zoom[j]):
            continue  # a closer look shows finer detail
        shared = evidence.cloud.points[np.union1d(points[i], points[j])]
        seen = [_sampled(evidence, view, maps[view], shared) for view in (i, j)]
        both = np.isfinite(seen[0]) & np.isfinite(seen[1])
        if both.sum() >= FEWEST:
            middle, deviation = robust_median((seen[0] - seen[1])[both, None])
            pairs.append((i, j))
            differences.append(float(middle[0]))
            std.append(float(deviation[0]))
    values, deviations = values_of_views(len(maps), pairs, np.array(differences), np.array(std))
    compared = np.bincount(np.array(pairs, np.int64).reshape(-1), minlength=len(maps))
    return np.where(compared >= FEWEST_PAIRS, values, np.nan), deviations


def against_neighbours(evidence: Evidence, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(views,) values less the median of the views that each is matched with: around a scene, small errors of pairs add up."""
    near: list[list[int]] = [[] for _ in values]
    for i, j in matching.pairs_of(evidence.matrices, evidence.focus):
        near[i].append(j)
        near[j].append(i)
    around = [values[some][np.isfinite(values[some])] for some in near]
    return values - np.array([np.median(some) if len(some) else np.nan for some in around])


def equivalent(evidence: Evidence, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(views,) Gaussian blur that lowers the contrast of sharp pictures as much [px]; 0 for those at or above the median.

    Views without a value (NaN) count as sharp.
    """
    sharp = np.argsort(np.where(np.isfinite(values), -values, np.inf))[: min(3, len(values))]
    curve = np.zeros(len(BLURS_PX))
    for view in sharp:
        picture = grey(evidence.pictures[view])
        shown = evidence.pictures[view][..., -1] > 0.5 if evidence.pictures[view].shape[-1] == 4 else np.ones(picture.shape, bool)
        if not shown.any():
            continue
        levels = [float(np.median(contrast(_blurred(picture, blur))[shown])) for blur in BLURS_PX]
        curve += (np.array(levels) - levels[0]) / len(sharp)
    known = np.isfinite(values)
    return np.where(known, np.interp(-np.where(known, values, 0.0), -np.minimum.accumulate(curve), BLURS_PX), 0.0)


def contrast(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """(height, width) log ratio of the energies of fine and coarse gradients around each pixel."""

    def energy(sigma: float) -> NDArray[np.float32]:
        smooth = _blurred(picture, sigma)
        across, down = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
        return _blurred(across**2 + down**2, WINDOW_PX)

    return np.log((energy(FINE_PX) + 1e-6) / (energy(COARSE_PX) + 1e-6))


def grey(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean of the channels; grey where nothing is, or no finite value."""
    mean = picture[..., :3].mean(-1)
    mean = np.where(np.isfinite(mean), mean, 0.5).astype(np.float32)
    return mean if picture.shape[-1] == 3 else mean * picture[..., 3] + 0.5 * (1 - picture[..., 3])


def _blurred(picture: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma), np.float32) if sigma > 0 else picture


def _sampled(evidence: Evidence, view: int, values: NDArray[np.float32], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) values of a view's map where it shows the points; NaN outside its picture or mask."""
    picture = evidence.pictures[view]
    height, width = picture.shape[:2]
    local = (points - evidence.matrices[view, :3, 3]) @ evidence.matrices[view, :3, :3]
    front = local[:, 2] > 1e-9
    camera = evidence.views[view].camera.scaled(width, height)
    column, row = np.floor(camera.project(np.where(front[:, None], local, [0, 0, 1.0]))).astype(int).T
    inside = front & (column >= 4) & (column < width - 4) & (row >= 4) & (row < height - 4)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    if picture.shape[-1] == 4:
        inside &= picture[row, column, 3] > 0.5
    return np.where(inside, values[row, column], np.nan)
