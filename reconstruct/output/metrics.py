"""Figures of merit: how far a rendered picture is from the truth.

All functions take numpy arrays of one picture and return a plain float; None where there is nothing to measure. What each
figure means is in `DEFINITIONS`, which goes along with every file of results.
"""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

Picture = Float[np.ndarray, "height width channels"]
Map = Float[np.ndarray, "height width 1"]

DEFINITIONS = {
    "psnr": ("dB", "-10 log10 of the mean squared error of clipped sRGB, over white where the picture has an alpha"),
    "ssim": ("", "structural similarity of the same pictures: Gaussian window 11x11, sigma 1.5, mean over pixels and channels"),
    "lpips": ("", "learned perceptual distance of the same pictures (Zhang et al. 2018): AlexNet, version 0.1, mean over pixels, summed over "
                  "layers; its weights are those of the file whose SHA-256 stands under lpips_weights"),
    "normal_mae_alpha_acc_deg": ("deg", "mean angle between rendered and true normals, weighted by true alpha times rendered opacity; "
                                        "normals from the density's gradient"),
    "normal_mae_deg": ("deg", "the same, weighted by true alpha alone"),
    "normal_pred_mae_alpha_acc_deg": ("deg", "mean angle between predicted and true normals, weighted by true alpha times rendered opacity"),
    "normal_pred_mae_deg": ("deg", "the same, weighted by true alpha alone"),
    "disparity_rmse": ("", "root mean square error of 1 / (1 + t), t the depth along z in world units, where true alpha > 0.5"),
    "depth_rmse_mm": ("mm", "root mean square error of the depth along z, where true alpha > 0.5 (metric scenes)"),
    "depth_median_mm": ("mm", "median absolute error of the same"),
    "diffuse_psnr": ("dB", "PSNR of the diffuse part, in clipped sRGB, over the object (true alpha > 0.5, everything where it is not known)"),
    "specular_psnr": ("dB", "PSNR of the specular part, in clipped sRGB, over the same pixels as that of the diffuse part"),
    "seconds": ("s", "time to render the view, all channels; compilation not counted"),
}  # fmt: skip
"""Unit and meaning of each figure of a view."""

BEST_MSE = 1e-10
"""Smaller mean squared errors count as this: 100 dB."""


def psnr(rendered: Picture, truth: Picture, shown: NDArray[np.bool_] | None = None) -> float | None:
    """Peak signal-to-noise ratio [dB] of two pictures after clipping to 0..1; at most 100.

    Args:
        shown: (height, width) pixels that count; None counts all. Where none does, there is no ratio.
    """
    error = np.clip(rendered, 0, 1).astype(np.float64) - np.clip(truth, 0, 1)
    error = error if shown is None else error[shown]
    if not error.size:
        return None
    return float(-10 * np.log10(max(np.mean(error**2), BEST_MSE)))


def ssim(rendered: Picture, truth: Picture) -> float | None:
    """Structural similarity (Wang et al. 2004) of two pictures after clipping to 0..1; None below 11 pixels."""
    from skimage.metrics import structural_similarity

    if min(truth.shape[:2]) < 11:
        return None
    return float(structural_similarity(np.clip(rendered, 0, 1).astype(np.float64), np.clip(truth, 0, 1).astype(np.float64),
                                       data_range=1.0, channel_axis=-1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False))  # fmt: skip


def angles_deg(first: Picture, second: Picture) -> NDArray[np.float64]:
    """(height, width) angle between unit vectors [deg]; 90 where one of them is zero.

    2 atan2(|a - b|, |a + b|) (Kahan), which is accurate at 0 and at 180 degrees, where the arc cosine is not.
    """
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    apart, together = np.linalg.norm(first - second, axis=-1), np.linalg.norm(first + second, axis=-1)
    return np.rad2deg(2 * np.arctan2(apart, together))


def normal_mae_deg(rendered: Picture, truth: Picture, weight: Map) -> float | None:
    """Mean angle [deg] between unit normals.

    Args:
        weight: at least 0; pixels whose true normal is zero do not count, whatever their weight.
    """
    weight = np.asarray(weight, np.float64)[..., 0] * (np.linalg.norm(truth, axis=-1) > 0.5)
    total = weight.sum()
    return float((angles_deg(rendered, truth) * weight).sum() / total) if total > 0 else None


def disparity_rmse(rendered: Map, truth: Map, shown: NDArray[np.bool_]) -> float | None:
    """Root mean square error of 1 / (1 + depth) over the pixels that are `shown`, (height, width)."""
    if not shown.any():
        return None
    first, second = (1 / (1 + np.maximum(values[shown].astype(np.float64), 0)) for values in (rendered, truth))
    return float(np.sqrt(np.mean((first - second) ** 2)))


def depth_errors_mm(rendered: Map, truth: Map, shown: NDArray[np.bool_]) -> tuple[float, float] | None:
    """Root mean square and median absolute error [mm] of depths [m] over the pixels that are `shown`, (height, width)."""
    if not shown.any():
        return None
    error = 1e3 * (rendered[shown].astype(np.float64) - truth[shown])
    return float(np.sqrt(np.mean(error**2))), float(np.median(np.abs(error)))
