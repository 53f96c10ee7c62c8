"""Merges exposures of different lengths into one picture, each value weighted by its inverse variance.

A sensor of shot noise `s` and read noise `r` reads a signal x with the variance r^2 + s x (both relative to the largest
value), plus that of rounding. Exposure i of the relative length t_i sees x_i = t_i y of the signal y of the longest one, so
y = sum(w_i x_i / t_i) / sum(w_i) with w_i = t_i^2 / var(x_i), and the variance of y is 1 / sum(w_i).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.imaging.images import linear_from_srgb, srgb_from_linear
from koala3d.datasets.radiometry.response import Response

SATURATED = 0.98
"""Values from here on [share of the largest] are lower bounds and left out."""

CERTAIN = 3.0
"""A shorter exposure says that a longer one is saturated from so many standard deviations on."""


@dataclass(frozen=True)
class Merged:
    """One picture of the signal of the longest exposure."""

    signal: NDArray[np.float32]
    """(height, width, channels), 1 is the largest value of the longest exposure; it may exceed 1."""
    deviation: NDArray[np.float32]
    """Standard deviation of each value."""
    clipped: NDArray[np.bool_]
    """(height, width, channels) saturated in all exposures: the value is a lower bound."""


def rounding_variance(signal: NDArray[np.float32], *, raw: bool) -> NDArray[np.float32]:
    """Variance of the rounding to 12 raw bits, or to 8 bits of sRGB: a twelfth of the squared step."""
    if raw:
        return np.full_like(signal, 1 / 4095**2 / 12)
    step = srgb_from_linear(np.clip(signal, 0, 1))
    return (linear_from_srgb(step + 0.5 / 255) - linear_from_srgb(step - 0.5 / 255)) ** 2 / 12


def variance(signal: NDArray[np.float32], response: Response, *, raw: bool) -> NDArray[np.float32]:
    """Variance of one reading of a signal."""
    return response.read**2 + response.shot * np.maximum(signal, 0) + rounding_variance(signal, raw=raw)


def merge(values: Sequence[NDArray[np.float32]], lengths: Sequence[float], response: Response, *, raw: bool) -> Merged:
    """Merge exposures.

    Args:
        values: (height, width, channels) linear values as `stored.linear` gives them, longest exposure first.
        lengths: their exposure times, in any unit.
        response: black level, hot pixels and noise of the sensor.
        raw: whether the values are raw, see `rounding_variance`.
    """
    times = np.asarray(lengths, np.float32) / np.float32(lengths[0])
    signals = [response.signal(value) for value in values]
    good = _usable(values, signals, times, response, raw=raw)
    clipped = ~np.any(good, axis=0)
    good[-1] = good[-1] | clipped
    # A first estimate by exposure time: weights from the readings themselves would favour those that are too low by chance
    total = sum(np.where(one, x, 0) for one, x in zip(good, signals, strict=True))
    seen = sum(np.where(one, t, 0) for one, t in zip(good, times, strict=True))
    first = np.asarray(total / seen, np.float32)
    weights = [np.where(one, t**2 / variance(first * t, response, raw=raw), 0) for one, t in zip(good, times, strict=True)]
    summed = np.asarray(sum(weights), np.float32)
    signal = sum(w * x / t for w, x, t in zip(weights, signals, times, strict=True)) / summed
    return Merged(np.asarray(signal, np.float32), 1 / np.sqrt(summed), clipped)


def _usable(
    values: Sequence[NDArray[np.float32]],
    signals: list[NDArray[np.float32]],
    times: NDArray[np.float32],
    response: Response,
    *,
    raw: bool,
) -> list[NDArray[np.bool_]]:
    """Which readings are not saturated, themselves and by what the next shorter exposure saw.

    The well of a pixel is full before the largest value in some sensors: its readings then vary below that.
    """
    good = [value < SATURATED for value in values]
    for index in range(len(values) - 1):
        factor, shorter = times[index] / times[index + 1], signals[index + 1]
        doubt = CERTAIN * np.sqrt(variance(shorter, response, raw=raw))
        good[index] &= factor * (shorter - doubt) < 1
    return good
