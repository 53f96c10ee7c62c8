"""Measures the response of a sensor from many pictures of darkness and of an evenly lit grey card."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.radiometry.mosaic import colour_indices, pattern_of, tiled
from koala3d.datasets.radiometry.response import Response

MIDDLE = 0.2
"""Share of width and height of the middle of the picture, where the flat field is 1 and white is balanced."""
GLOWS = 0.004
"""A pixel is hot if its mean without light is this much [share of the largest value] above black, and above `SPREAD` of all."""
SPREAD = 8.0
SEES = 0.5
"""A pixel is dead if it sees less than this share of what its surroundings see."""
DIM, BRIGHT = 0.1, 0.95
"""The mean of a card's picture in the middle has to lie between these in every colour [share of the largest value]."""


@dataclass(frozen=True)
class Statistics:
    """Mean and variance over pictures of the same thing."""

    count: int
    mean: NDArray[np.float64]  # (height, width, channels)
    variance: NDArray[np.float64]

    @classmethod
    def of(cls, pictures: Iterable[NDArray[np.float32]]) -> "Statistics":
        """Of (height, width, channels) pictures; at least two. By Welford's recurrence (1962)."""
        count, mean, total = 0, np.zeros(()), np.zeros(())
        for picture in pictures:
            count += 1
            step = picture - mean
            mean = mean + step / count
            total = total + step * (picture - mean)
        if count < 2:
            raise UsageError("too few pictures for a measurement", why=f"{count}, at least 2 are needed", remedy="take more")
        return cls(count, mean, total / (count - 1))


def response(
    dark: Statistics, card: Statistics, *, serial: str, pixel_format: str, region: Region, gain_db: float, raw: bool
) -> Response:
    """The response of a sensor.

    Args:
        dark: of pictures with the lens covered.
        card: of pictures that an evenly lit grey card fills, with the same gain.
        raw: whether the pictures are mosaics where the format is one; else they are developed.

    Raises UsageError: the card is too dark, too bright or unevenly lit, or light fell into the dark pictures.
    """
    pattern = pattern_of(pixel_format) if raw else ""
    period = 2 if pattern else 1
    black = _per_plane(dark.mean, period)
    glowing = _glowing(dark.mean, period, black)
    signal = card.mean - _spread(black, dark.mean.shape)
    middle = _per_plane(_cut(signal, period), period)
    _check(black, middle)
    seen = signal / _spread(middle, signal.shape)
    around = _surroundings(seen, period)
    hot = glowing | (seen < SEES * around).any(-1)
    shot, read = _noise(dark, card, signal, hot)
    return Response(
        serial,
        pixel_format,
        region,
        gain_db,
        black,
        _balance(middle / (1 - black), pattern),
        np.maximum(np.where(hot[..., None], around, seen), 1e-3).astype(np.float16),
        np.argwhere(hot).astype(np.int32),
        shot,
        read,
    )


def rebalanced(known: Response, values: NDArray[np.float32], rows: slice, columns: slice, *, raw: bool) -> Response:
    """A response with the white balance of a grey card in a part of a picture.

    Args:
        known: black level and flat field.
        values: (height, width, channels) linear values, mean of several pictures.
        rows: of the card.
        columns: of the card.
        raw: as of `response`.

    Raises UsageError: the card is too dark or too bright.
    """
    pattern = pattern_of(known.pixel_format) if raw else ""
    period = 2 if pattern else 1
    even = known.signal(values) / known.flat.astype(np.float32)
    part = even[rows.start // period * period : rows.stop, columns.start // period * period : columns.stop]
    middle = _per_plane(np.asarray(part, np.float64), period)
    _check(0 * known.black, middle)
    return replace(known, balance=_balance(middle, pattern))


def _check(black: NDArray[np.float64], middle: NDArray[np.float64]) -> None:
    if black.max() > DIM:
        why = f"their black is {100 * black.max():.1f} % of the largest value"
        raise UsageError("light fell into the dark pictures", why=why, remedy="cover the lens")
    whole = middle + black
    if middle.min() < DIM or whole.max() > BRIGHT:
        why = f"its colours reach {100 * middle.min():.0f} to {100 * whole.max():.0f} % of the largest value"
        remedy = "change --set camera.exposure_us so that the brightest is near 60 %"
        raise UsageError("the card is too dark or too bright", why=why, remedy=remedy)


def _glowing(dark: NDArray[np.float64], period: int, black: NDArray[np.float64]) -> NDArray[np.bool_]:
    above = dark - _spread(black, dark.shape)
    usual = 1.4826 * float(np.median(np.abs(above)))
    return (above > max(GLOWS, SPREAD * usual)).any(-1)


def _noise(dark: Statistics, card: Statistics, signal: NDArray[np.float64], hot: NDArray[np.bool_]) -> tuple[float, float]:
    """Shot and read noise by the photon transfer method: the variance grows in proportion to the signal (Janesick 1987)."""
    good = ~hot
    read = float(dark.variance[good].mean())
    shot = float((card.variance[good].mean() - read) / signal[good].mean())
    return max(shot, 1e-7), max(np.sqrt(read), 1e-5)


def _balance(middle: NDArray[np.float64], pattern: str) -> NDArray[np.float64]:
    """Factors that bring each plane to the green one."""
    if middle.size == 1:
        return np.ones_like(middle)
    index = colour_indices(pattern) if pattern else np.arange(3).reshape(1, 1, 3)
    return middle[index == 1].mean() / middle


def _per_plane(picture: NDArray[np.float64], period: int) -> NDArray[np.float64]:
    """(period, period, channels) median of each plane."""
    return np.array([[np.median(picture[i::period, j::period], axis=(0, 1)) for j in range(period)] for i in range(period)])


def _spread(planes: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    return tiled(planes, shape[0], shape[1])


def _cut(picture: NDArray[np.float64], period: int) -> NDArray[np.float64]:
    """The middle of the picture, begun at the first place of the pattern."""
    height, width = picture.shape[:2]
    top, left = (int(edge * (1 - MIDDLE) / 2) // period * period for edge in (height, width))
    return picture[top : height - top, left : width - left]


def _surroundings(seen: NDArray[np.float64], period: int) -> NDArray[np.float64]:
    """Median over 5 x 5 pixels of the same plane."""
    from scipy.ndimage import median_filter

    found = np.empty_like(seen)
    for i in range(period):
        for j in range(period):
            found[i::period, j::period] = median_filter(seen[i::period, j::period], size=(5, 5, 1), mode="nearest")
    return found
