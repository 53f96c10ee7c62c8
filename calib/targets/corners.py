"""Corners of a checkered target to a few thousandths of a pixel, by fitting a model of a corner's picture.

Around a corner c, where two edges with unit normals n1, n2 cross, a picture blurred by s pixels is

    brightness(u) = level + slope . v + contrast * (o + erf(n1 . v / (s sqrt 2))) * (o + erf(n2 . v / (s sqrt 2))),  v = u - c

with o = 0 where two dark squares touch. At the corner of a single dark tag, where one of the four quarters is dark, o = 1 and
both normals point into the tag.

All corners of a view are fitted at once by Gauss-Newton. Each uses the pixels of a disc on the board (an ellipse in the
picture) that contains no marker and no other corner. Unlike `cornerSubPix`, which weighs gradients, this is unbiased for
tilted boards. Pixel coordinates here are OpenCV's: the first centre is at (0, 0).
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from koala3d.calib.arrays import Array

MAX_RADIUS_PX = 9  # pixels further from the corner are left out: there the lens bends the edges
MIN_PIXELS = 24  # a corner with fewer pixels in its disc keeps its place
MAX_SHIFT_PX = 1.5  # a fit that ends further from its start is wrong
_STEPS = 15
_SETTLED = 1e-5  # steps of all corners below this are the last ones [px, and the units of the other parameters]


def fit(
    grey: NDArray[np.float32], start: Array, points: Array, clear_m: float, inwards: Array | None = None, *, or_start: bool = True
) -> Array:
    """Corners near `start`.

    Args:
        grey: (height, width) brightness 0..1.
        start: (n, 2) where they are to about half a pixel [px].
        points: (n, 2) where they are on the board [m]; n >= 4, not on a line.
        clear_m: radius of the disc on the board in which nothing but the corner's two edges is seen [m].
        inwards: (n, 2) signs of the directions along the board's x and y that lead into the tag; None where dark squares touch.

    Returns:
        (n, 2) corners [px]; where no fit was possible, the start, or NaN without `or_start`.
    """
    pixels_per_metre = _local_scale(start, points)
    offsets, values, weight = _patches(grey, start, pixels_per_metre, clear_m)
    parameters, offset = _initial(values, weight, pixels_per_metre, inwards), 0.0 if inwards is None else 1.0
    moved = np.zeros(len(start), bool)
    for _ in range(_STEPS):
        predicted, jacobian = _model(parameters, offsets, offset)
        weighted = jacobian * weight[..., None]
        normal = np.swapaxes(weighted, 1, 2) @ jacobian
        diagonal = np.einsum("nii->ni", normal)
        diagonal += 1e-4 * diagonal + 1e-9
        step = np.linalg.solve(normal, np.einsum("nmk,nm->nk", weighted, values - predicted)[..., None])[..., 0]
        step[:, :2] = np.clip(step[:, :2], -0.5, 0.5)
        step[:, 2:5] = np.clip(step[:, 2:5], -0.2, 0.2)
        parameters = parameters + step
        moved = np.abs(step[:, :2]).max(1) > 1e-3
        if np.abs(step).max() < _SETTLED:
            break
    shift, blur = parameters[:, :2], _blur(parameters)
    good = (weight.sum(1) >= MIN_PIXELS) & ~moved & (np.linalg.norm(shift, axis=1) < MAX_SHIFT_PX)
    good &= np.isfinite(parameters).all(1) & (blur < 4) & (np.abs(parameters[:, 5]) > 0.02)
    return start + np.where(good[:, None], shift, 0.0 if or_start else np.nan)


def _local_scale(start: Array, points: Array) -> Array:
    """(n, 2, 2) derivative of pixels by board coordinates at each corner [px / m], from one homography."""
    homography, _ = cv2.findHomography(points, start, cv2.LMEDS)
    if homography is None:
        homography, _ = cv2.findHomography(points, start)
    projected = np.column_stack([points, np.ones(len(points))]) @ homography.T
    pixels = projected[:, :2] / projected[:, 2:]
    return (homography[:2, :2] - pixels[..., None] * homography[2, :2]) / projected[:, 2, None, None]


def _patches(grey: NDArray[np.float32], start: Array, scale: Array, clear_m: float) -> tuple[Array, Array, Array]:
    """(n, m, 2) offsets of pixel centres from the start, (n, m) brightness there, (n, m) 1 inside the disc, else 0."""
    height, width = grey.shape
    largest = clear_m * np.linalg.norm(scale, 2, axis=(1, 2)).max()  # radius of a disc in the picture [px]
    most = int(min(MAX_RADIUS_PX, largest + 0.5))
    reach = np.arange(-most, most + 1)
    window = np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2)
    pixels = np.rint(start).astype(int)[:, None] + window
    offsets = pixels - start[:, None]
    inside = np.all((pixels >= 0) & (pixels < [width, height]), axis=-1)
    column, row = np.moveaxis(np.where(inside[..., None], pixels, 0), -1, 0)
    on_board = np.einsum("nij,nmj->nmi", np.linalg.inv(scale), offsets)
    near = (np.linalg.norm(on_board, axis=-1) <= clear_m) & (np.linalg.norm(offsets, axis=-1) <= MAX_RADIUS_PX)
    return offsets, grey[row, column].astype(np.float64), (near & inside).astype(np.float64)


def _initial(values: Array, weight: Array, scale: Array, inwards: Array | None) -> Array:
    """(n, 9) start: no shift, normals as on the board, lens blur of 0.5 px, contrast and level by least squares."""
    count = np.maximum(weight.sum(1), 1)
    level = (values * weight).sum(1) / count
    edges = np.arctan2(scale[:, 1], scale[:, 0])  # (n, 2) directions of the board's x and y axes in the picture
    parameters = np.zeros((len(values), 9))
    parameters[:, 2:4], parameters[:, 4], parameters[:, 6] = edges[:, ::-1] + np.pi / 2, np.log(0.5), level
    parameters[:, 5] = np.sqrt(((values - level[:, None]) ** 2 * weight).sum(1) / count)
    if inwards is not None:
        # a quarter dark: of the range, which is 4 contrasts, the mean lies 1/4 below white, and the deviation is 0.43
        parameters[:, 5] *= -0.577
        parameters[:, 6] -= parameters[:, 5]
        x, y = inwards.T
        parameters[:, 2] += np.pi * (x > 0)
        parameters[:, 3] += np.pi * (y < 0)
    return parameters


def _blur(parameters: Array) -> Array:
    """(n,) standard deviation of the blur [px]: of the lens, and of a square pixel, whose variance is 1/12 in any direction."""
    return np.sqrt(np.exp(2 * parameters[:, 4]) + 1 / 12)


def _model(parameters: Array, offsets: Array, offset: float) -> tuple[Array, Array]:
    """(n, m) brightness and (n, m, 9) derivative by shift (2), two angles, log of the lens's blur, contrast, level, slope (2)."""
    shift, angles, blur = parameters[:, None, :2], parameters[:, 2:4], _blur(parameters)[:, None]
    contrast, level, slope = parameters[:, 5, None], parameters[:, 6, None], parameters[:, 7:]
    from_corner = offsets - shift
    values, derivatives, scaled, turned = [], [], [], []
    for angle in angles.T:
        normal, tangent = np.stack([np.cos(angle), np.sin(angle)], -1), np.stack([-np.sin(angle), np.cos(angle)], -1)
        distance = np.einsum("nmi,ni->nm", from_corner, normal) / blur
        values.append(offset + erf(distance / np.sqrt(2)))
        derivatives.append(np.sqrt(2 / np.pi) * np.exp(-0.5 * distance**2))
        scaled.append(distance)
        turned.append((normal, np.einsum("nmi,ni->nm", from_corner, tangent) / blur))
    by_distance = [contrast * derivatives[0] * values[1], contrast * derivatives[1] * values[0]]
    jacobian = np.empty((*values[0].shape, 9))
    for axis in range(2):
        pull = by_distance[0] * turned[0][0][:, axis, None] + by_distance[1] * turned[1][0][:, axis, None]
        jacobian[..., axis] = -pull / blur - slope[:, axis, None]
        jacobian[..., 2 + axis] = by_distance[axis] * turned[axis][1]
    of_lens = np.exp(2 * parameters[:, 4, None]) / blur**2  # share of the lens in the blur's square
    jacobian[..., 4] = -of_lens * (by_distance[0] * scaled[0] + by_distance[1] * scaled[1])
    jacobian[..., 5], jacobian[..., 6], jacobian[..., 7:] = values[0] * values[1], 1.0, from_corner
    return contrast * values[0] * values[1] + level + np.einsum("nmi,ni->nm", from_corner, slope), jacobian
