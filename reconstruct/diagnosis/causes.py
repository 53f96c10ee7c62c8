"""From the residuals of all views to causes: what stands out in single views, and what all views share."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.findings import Finding
from koala3d.reconstruct.diagnosis.residuals import Residual

OUTSTANDING = 3.5
"""Robust standard deviations of the other views."""
GAIN, COLOUR, SHIFT_PX, BLUR = np.log(1.1), np.log(1.06), 0.5, 0.35
"""Least log gain, log gain of one channel, shift, and log sharpness that are reported."""
REGION, REGION_SHARE = 12.0, 0.4
"""A region's error is reported if it is this many times the region's usual one, and this share of its picture's error."""
BEHIND_DB = 2.0


def find(residuals: Sequence[Residual]) -> list[Finding]:
    """Findings on views, the worst first within each cause."""
    if len(residuals) < 4:
        return []
    return [*_light(residuals), *_shifted(residuals), *_blurred(residuals), *_regions(residuals), *_unseen(residuals)]


def standing_out(values: NDArray[np.float64], least: float) -> NDArray[np.int64]:
    """Indices of values whose distance from the median exceeds `least` and that of the others."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(0, np.int64)
    off = np.abs(values - np.median(values[known]))
    limit = max(least, OUTSTANDING * 1.4826 * float(np.median(off[known])))
    return np.flatnonzero(off > limit)


def _light(residuals: Sequence[Residual]) -> list[Finding]:
    logs = np.log(np.array([one.gains for one in residuals]))
    common = logs.mean(1)
    found = []
    for i in standing_out(common, GAIN):
        why = f"its picture has {np.exp(common[i] - np.nanmedian(common)):.2f} times the light of its rendering"
        remedy = "fix the exposure while recording, or learn a gain per view: --set train.per_image=exposure"
        found.append(_of_view(residuals[i], "exposure differs from the other views'", why, remedy, "exposure", np.exp(common[i])))
    colour = logs - common[:, None]
    for i in sorted({int(i) for channel in colour.T for i in standing_out(channel, COLOUR)}):
        words = "/".join(f"{value:.2f}" for value in np.exp(colour[i]))
        why = f"red/green/blue against its rendering: {words}"
        remedy = "fix the white balance while recording, or learn a gain per colour: --set train.per_image=colour"
        strength = float(np.abs(colour[i]).max())
        found.append(
            _of_view(residuals[i], "white balance differs from the other views'", why, remedy, "white balance", strength)
        )
    return found


def _shifted(residuals: Sequence[Residual]) -> list[Finding]:
    length = np.array([float(np.linalg.norm(one.shift_px)) for one in residuals], np.float64)
    found = []
    for i in standing_out(length, SHIFT_PX):
        why = "its picture is shifted by ({:+.1f}, {:+.1f}) px against its rendering".format(*residuals[i].shift_px)
        remedy = "let training refine poses: --set poses.enabled=true, or drop the view"
        found.append(_of_view(residuals[i], "pose does not fit the model", why, remedy, "pose", float(length[i])))
    return found


def _blurred(residuals: Sequence[Residual]) -> list[Finding]:
    values = np.array([one.sharper for one in residuals])
    chosen = [i for i in standing_out(values, BLUR) if values[i] < np.median(values)]
    remedy = "take it again with the camera at rest and in focus, or drop it"
    found = []
    for i in chosen:
        less = 1 - np.exp(values[i] - np.median(values))
        why = f"it has {100 * less:.0f}% less fine detail than the other pictures, compared with their renderings"
        found.append(_of_view(residuals[i], "picture is blurred", why, remedy, "blur", float(values[i])))
    return found


def _regions(residuals: Sequence[Residual]) -> list[Finding]:
    """Regions whose error is far above what pictures have there: something moves, or a mask is wrong."""
    shapes = {one.blocks.shape for one in residuals}
    if len(shapes) != 1:
        return []
    blocks = np.stack([one.blocks for one in residuals])
    usual = float(np.median(blocks.mean((1, 2))))
    found = []
    for one, values in zip(residuals, blocks, strict=True):
        worst = np.unravel_index(int(values.argmax()), values.shape)
        share = float(values[worst] / max(values.sum(), 1e-12))
        if values[worst] < REGION * usual or share < REGION_SHARE / 2:
            continue
        height, width = one.error_map.shape
        top, left = (int(k * size / n) for k, size, n in zip(worst, (height, width), values.shape, strict=True))
        why = f"{100 * share:.0f}% of its error lies around x {left}, y {top} of its {width}x{height} map"
        remedy = "look whether something moved or the mask is wrong there; mask it"
        found.append(_of_view(one, "error is concentrated in one region", why, remedy, "motion", share))
    return found


def _unseen(residuals: Sequence[Residual]) -> list[Finding]:
    by_split = {split: [one.psnr for one in residuals if one.split == split] for split in ("train", "test")}
    if min(map(len, by_split.values())) < 2:
        return []
    behind = float(np.mean(by_split["train"]) - np.mean(by_split["test"]))
    if behind < BEHIND_DB:
        return []
    why = f"{np.mean(by_split['test']):.1f} dB, training views {np.mean(by_split['train']):.1f} dB"
    remedy = "take more views; see above for views that contradict the others"
    what = "test views are much worse than training views"
    return [Finding("warning", what, "test views", why, remedy, "training", {"behind_db": behind})]


def _of_view(one: Residual, what: str, why: str, remedy: str, cause: str, figure: float) -> Finding:
    return Finding("warning", what, f"view {one.name}", why, remedy, cause, {"views": {one.name: float(figure)}})
