"""What a picture has that its rendering has not, in terms of causes: light, colour, shift, sharpness, and where the rest lies."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.imaging import images

Picture = NDArray[np.float32]

DARK, CLIPPED = 0.01, 0.9
"""Linear light outside which a pixel says nothing of the exposure."""
FEWEST = 50
"""Pixels with which a gain is measured."""
SMOOTH_PX = 1.5
"""Blur of both pictures before a shift is measured: half of the shift that is found in one step."""
BLOCKS = 8
"""Regions of a picture along its longer side."""


@dataclass(frozen=True, eq=False)
class Residual:
    """One view against its rendering."""

    name: str
    split: str
    psnr: float
    gains: NDArray[np.float64]
    """(3,) light of the picture over that of the rendering, the median of the pixels; NaN where they are too few."""
    shift_px: NDArray[np.float64]
    """(2,) how far the picture's content lies right of and below the rendering's."""
    sharper: float
    """Energy of the picture's fine gradients over the rendering's, as a logarithm; negative where the picture is blurred."""
    error_map: Picture
    """(height, width) root mean square error of the channels, sRGB."""
    blocks: NDArray[np.float64]
    """(rows, columns) mean squared error of each region."""
    truth: Picture
    rendered: Picture


def residual(name: str, split: str, truth: Picture, rendered: Picture) -> Residual:
    """Compare (height, width, 3) sRGB pictures of one view, both over the same background."""
    squared = ((truth - rendered) ** 2).mean(-1)
    psnr = -10 * float(np.log10(max(float(squared.mean()), 1e-10)))
    lit = (gains_of(truth, rendered), shift(truth, rendered), sharpness(truth) - sharpness(rendered))
    return Residual(name, split, psnr, *lit, np.sqrt(squared), by_block(squared), truth, rendered)


def gains_of(truth: Picture, rendered: Picture) -> NDArray[np.float64]:
    """(3,) median ratio of linear light, over pixels that are neither dark nor clipped."""
    first, second = (images.linear_from_srgb(cv2.GaussianBlur(picture, (0, 0), 2.0)) for picture in (truth, rendered))
    known = (np.minimum(first, second) > DARK).all(-1) & (np.maximum(first, second) < CLIPPED).all(-1)
    if known.sum() < FEWEST:
        return np.full(3, np.nan)
    return np.exp(np.median(np.log(first[known] / second[known]), axis=0)).astype(np.float64)


def relit(rendered: Picture, truth: Picture, *, colours: bool) -> Picture:
    """A rendering in its picture's light: multiplied by its gain, or by one for each of the `colours`."""
    gains = gains_of(truth, rendered)
    if not np.isfinite(gains).all():
        return rendered
    wanted = gains if colours else np.full(3, np.exp(np.log(gains).mean()))
    light = images.linear_from_srgb(rendered) * wanted.astype(np.float32)
    return np.clip(images.srgb_from_linear(light), 0, 1).astype(np.float32)


def shift(truth: Picture, rendered: Picture) -> NDArray[np.float64]:
    """(2,) shift of `truth` against `rendered` [px]: Lucas and Kanade (1981) with one window, three steps, free gain."""
    first, second = (cv2.GaussianBlur(picture.mean(-1), (0, 0), SMOOTH_PX) for picture in (truth, rendered))
    down, across = np.gradient(second)
    moved, height, width = np.zeros(2), *second.shape
    design = np.stack([across, down, second, np.ones_like(second)], axis=-1).reshape(-1, 4)
    for _ in range(3):
        back = cv2.warpAffine(
            first, np.array([[1, 0, -moved[0]], [0, 1, -moved[1]]]), (width, height), borderMode=cv2.BORDER_REPLICATE
        )
        target = (second - back).reshape(-1)
        weight = 1 / (1 + (target / 0.1) ** 2)  # what does not repeat at all counts little
        weighted = design * weight[:, None]
        step = np.linalg.solve(design.T @ weighted + 1e-6 * np.eye(4), weighted.T @ target)[:2]
        moved = moved + np.clip(step, -2, 2)
    return moved


def sharpness(picture: Picture) -> float:
    """Logarithm of the energy of fine gradients over that of coarse ones."""

    def energy(sigma: float) -> float:
        smooth = cv2.GaussianBlur(picture.mean(-1), (0, 0), sigma)
        return float(np.mean(np.square(np.gradient(smooth))))

    return float(np.log((energy(0.6) + 1e-8) / (energy(2.0) + 1e-8)))


def by_block(squared: Picture) -> NDArray[np.float64]:
    """(rows, columns) mean of (height, width) values over regions of about equal sides."""
    side = max(squared.shape) / BLOCKS
    size = [max(1, round(length / side)) for length in squared.shape]
    return cv2.resize(squared, (size[1], size[0]), interpolation=cv2.INTER_AREA).astype(np.float64)
