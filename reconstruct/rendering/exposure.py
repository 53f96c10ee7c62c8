"""Exposure of views that no training has seen: fitted on one half of a picture, measured on the other.

A gain multiplies linear light. The value of a clipped channel is a lower bound of its light.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from koala3d.datasets.imaging.images import linear_from_srgb, srgb_from_linear

FURTHEST = 3.0
"""Largest log gain that is looked for."""
PIXELS = 20_000
"""Pixels that a gain is fitted on, at most."""

Colours = Float[np.ndarray, "*pixels 3"]


def left_half(height: int, width: int) -> Bool[np.ndarray, "height width"]:
    """Pixels of the left half of a picture."""
    return np.broadcast_to(np.arange(width) < width / 2, (height, width))


def across_halves(
    rendered: Mapping[str, NDArray[np.float32]], truth: Colours, left: Bool[np.ndarray, "*pixels"], behind: float, gains: int
) -> tuple[Colours, list[list[float]]]:
    """Rendered colours of one view, each half with the exposure that fits the other.

    Args:
        rendered: "rgb" in sRGB over the background and "opacity".
        truth: sRGB over the same background.
        left: which pixels are the first half.
        behind: the background, sRGB.
        gains: 1 for one gain, 3 for one per colour.

    Returns:
        The colours, and the log gains fitted on the first half and on the other.
    """
    rgb, opacity = np.asarray(rendered["rgb"]), np.asarray(rendered["opacity"])
    fits = [fitted(rgb[half], opacity[half], truth[half], behind, gains) for half in (left, ~left)]
    chosen = np.where(left[..., None], fits[1], fits[0])
    return exposed(rgb, opacity, behind, chosen), [fit.tolist() for fit in fits]


def exposed(rgb: Colours, opacity: Float[np.ndarray, "*pixels 1"], behind: float, log_gain: Float[np.ndarray, "..."]) -> Colours:
    """Colours over a background with the light of what is before it multiplied by exp(log_gain), clipped to 1."""
    before = np.maximum(opacity, 1e-6)
    own = np.clip((rgb - (1 - opacity) * behind) / before, 0, 1)
    light = linear_from_srgb(own) * np.exp(log_gain)
    return (np.minimum(srgb_from_linear(light), 1) * opacity + (1 - opacity) * behind).astype(np.float32)


def fitted(
    rgb: Float[np.ndarray, "n 3"], opacity: Float[np.ndarray, "n 1"], truth: Float[np.ndarray, "n 3"], behind: float, gains: int
) -> NDArray[np.float64]:
    """(gains,) log gains with the least squared error in sRGB; zero where there is nothing to fit."""
    step = max(1, len(rgb) // PIXELS)
    rgb, opacity, truth = rgb[::step], opacity[::step], truth[::step]
    if not np.any(opacity > 0):
        return np.zeros(gains)
    groups = [slice(0, 3)] if gains == 1 else [slice(k, k + 1) for k in range(gains)]

    def found(colours: slice) -> float:
        error = lambda log_gain: float(  # noqa: E731
            np.mean((exposed(rgb[:, colours], opacity, behind, log_gain) - truth[:, colours]) ** 2)
        )
        best: Any = minimize_scalar(error, bounds=(-FURTHEST, FURTHEST), method="bounded", options={"xatol": 1e-3})
        return float(best.x)

    return np.array([found(colours) for colours in groups])
