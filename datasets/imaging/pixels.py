"""Rearranged pixels: averages over areas, and orientations."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def area_average(pixels: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    """(height, width, channels) means of (old height, old width, channels) values, for any factor."""
    old_height, old_width, channels = pixels.shape
    if width <= old_width and height <= old_height and channels <= 4:
        import cv2

        small = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
        return np.asarray(small, np.float32).reshape(height, width, channels)
    rows = _overlaps(old_height, height) @ pixels.reshape(old_height, -1)
    turned = rows.reshape(height, old_width, channels).transpose(1, 0, 2).reshape(old_width, -1)
    columns = _overlaps(old_width, width) @ turned
    return np.ascontiguousarray(columns.reshape(width, height, channels).transpose(1, 0, 2), np.float32)


def resize_light(light: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    """Area average of linear light: 1 or 3 channels of colour, or 2 or 4 with a straight alpha, which weights the colours."""
    if light.shape[:2] == (height, width) or light.shape[-1] not in (2, 4):
        return area_average(light, width, height) if light.shape[:2] != (height, width) else light.copy()
    alpha = light[..., -1:]
    small = area_average(np.concatenate([light[..., :-1] * alpha, alpha], axis=-1), width, height)
    small_alpha = small[..., -1:]
    straight = small[..., :-1] / np.where(small_alpha > 0, small_alpha, 1.0)
    return np.concatenate([straight, small_alpha], axis=-1, dtype=np.float32)


def _overlaps(old: int, new: int) -> Any:
    """Sparse (new, old) matrix: the share of new pixel i that old pixel j covers; rows sum to 1."""
    from scipy.sparse import csr_array

    edges = np.unique(np.concatenate([np.arange(old + 1) / old, np.arange(new + 1) / new]).round(12))
    middle, length = (edges[1:] + edges[:-1]) / 2, np.diff(edges) * new
    entry = (np.minimum((middle * new).astype(int), new - 1), np.minimum((middle * old).astype(int), old - 1))
    return csr_array((length.astype(np.float32), entry), shape=(new, old))


def upright(pixels: NDArray[Any], orientation: int) -> NDArray[Any]:
    """(height, width, channels) as a viewer shows them: orientations 5 to 8 exchange rows and columns, the others mirror."""
    if orientation >= 5:
        pixels = pixels.transpose(1, 0, 2)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels
