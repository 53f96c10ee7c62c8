"""Metrics: the error of a rendered image.

All functions take numpy arrays of one image and return a float, or None if there is nothing to compare. `DEFINITIONS` is part
of every file of results.
"""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

Picture = Float[np.ndarray, "height width channels"]
Map = Float[np.ndarray, "height width 1"]

_ANGLE = "mean angle between {} and true normals, weighted by {}"
_WEIGHTS = ("true alpha times rendered opacity", "true alpha only")
_LPIPS = "learned perceptual distance of the same images (Zhang et al. 2018): AlexNet, version 0.1, mean over pixels, summed over"
_INSIDE = "of the same images inside the mask less its edge: pixels whose 11x11 window has a true alpha above 0.5 throughout"
_PART = "PSNR of the {} part in clipped sRGB, over the object (true alpha > 0.5; everything if alpha is unknown)"
DEFINITIONS = {
    "psnr": ("dB", "-10 log10 of the mean squared error of clipped sRGB, over white where the image has an alpha"),
    "ssim": ("", "structural similarity of the same images: Gaussian window 11x11, sigma 1.5, mean over pixels and channels"),
    "psnr_inside": ("dB", f"PSNR {_INSIDE}"),
    "ssim_inside": ("", f"structural similarity {_INSIDE}"),
    "lpips": ("", f"{_LPIPS} layers; lpips_weights has the SHA-256 of the weights"),
    "normal_mae_alpha_acc_deg": ("deg", _ANGLE.format("rendered", _WEIGHTS[0]) + "; normals from the density's gradient"),
    "normal_mae_deg": ("deg", _ANGLE.format("rendered", _WEIGHTS[1]) + "; normals from the density's gradient"),
    "normal_pred_mae_alpha_acc_deg": ("deg", _ANGLE.format("predicted", _WEIGHTS[0])),
    "normal_pred_mae_deg": ("deg", _ANGLE.format("predicted", _WEIGHTS[1])),
    "disparity_rmse": ("", "root mean square error of 1 / (1 + t), t the depth along z in world units, where true alpha > 0.5"),
    "depth_rmse_mm": ("mm", "root mean square error of the depth along z, where true alpha > 0.5 (metric scenes)"),
    "depth_median_mm": ("mm", "median absolute error of the depth along z, where true alpha > 0.5 (metric scenes)"),
    "diffuse_psnr": ("dB", _PART.format("diffuse")),
    "specular_psnr": ("dB", _PART.format("specular")),
    "seconds": ("s", "time to render the view, all channels, without compilation"),
}
"""Unit and meaning of each metric of a view."""

WINDOW = 11  # width of the window of the structural similarity [px]
BEST_MSE = 1e-10  # lower bound of the mean squared error: 100 dB


def psnr(rendered: Picture, truth: Picture, shown: NDArray[np.bool_] | None = None) -> float | None:
    """Peak signal-to-noise ratio [dB] of two images after clipping to 0..1; at most 100.

    Args:
        shown: (height, width) pixels to compare; None for all.
    """
    error = np.clip(rendered, 0, 1).astype(np.float64) - np.clip(truth, 0, 1)
    error = error if shown is None else error[shown]
    if not error.size:
        return None
    return float(-10 * np.log10(max(np.mean(error**2), BEST_MSE)))


def ssim(rendered: Picture, truth: Picture, shown: NDArray[np.bool_] | None = None) -> float | None:
    """Structural similarity (Wang et al. 2004) of two images after clipping to 0..1; None below 11 pixels.

    Args:
        shown: (height, width) pixels to average over; None for all whose window lies in the image.
    """
    from skimage.metrics import structural_similarity

    if min(truth.shape[:2]) < WINDOW or (shown is not None and not shown.any()):
        return None
    clipped = (np.clip(picture, 0, 1).astype(np.float64) for picture in (rendered, truth))
    options = {"data_range": 1.0, "channel_axis": -1, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    found: Any = structural_similarity(*clipped, full=True, **options)
    return float(found[0] if shown is None else found[1][shown].mean())


def inside(alpha: Map) -> NDArray[np.bool_]:
    """(height, width) pixels of the object that no edge of its mask affects: a mask may be wrong there by a few pixels.

    All of the pixel's window in `ssim` belongs to the object (alpha > 0.5); what is beyond the image counts as the object.
    """
    from scipy.ndimage import minimum_filter

    return np.asarray(minimum_filter(alpha[..., 0] > 0.5, size=WINDOW, mode="constant", cval=1), bool)


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
        weight: at least 0; pixels without a true normal are ignored.
    """
    weight = np.asarray(weight, np.float64)[..., 0] * (np.linalg.norm(truth, axis=-1) > 0.5)
    total = weight.sum()
    return float((angles_deg(rendered, truth) * weight).sum() / total) if total > 0 else None


def disparity_rmse(rendered: Map, truth: Map, shown: NDArray[np.bool_]) -> float | None:
    """Root mean square error of 1 / (1 + depth) over the `shown` (height, width) pixels."""
    if not shown.any():
        return None
    first, second = (1 / (1 + np.maximum(values[shown].astype(np.float64), 0)) for values in (rendered, truth))
    return float(np.sqrt(np.mean((first - second) ** 2)))


def depth_errors_mm(rendered: Map, truth: Map, shown: NDArray[np.bool_]) -> tuple[float, float] | None:
    """Root mean square and median absolute error [mm] of depths [m] over the `shown` (height, width) pixels."""
    if not shown.any():
        return None
    error = 1e3 * (rendered[shown].astype(np.float64) - truth[shown])
    return float(np.sqrt(np.mean(error**2))), float(np.median(np.abs(error)))
