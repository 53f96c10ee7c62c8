"""Flicker of mains-powered lamps, from a burst of pictures.

Lamps flicker with twice the frequency f of the mains: 100 or 120 Hz. An exposure of the length T sees the share
|sinc(f T)| of the amplitude, nothing where T is a multiple of 1 / f. What is left beats with the times of the exposures. It is
found by least squares, m(t) = a + b cos(2 pi f t) + c sin(2 pi f t), in bands of the picture's rows, each with its own
phase: a rolling shutter exposes them one after the other.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.protocols import Camera
from koala3d.capture.sessions.live.analysis import Part
from koala3d.capture.sessions.live.flat import values_of
from koala3d.datasets.radiometry.merge import SATURATED
from koala3d.datasets.radiometry.response import Response

FREQUENCIES_HZ = (100.0, 120.0)
BANDS = 8
SEEN, SURE = 0.002, 4.0
"""The picture flickers where the amplitude exceeds this share of its light, and so many standard errors."""
CLEAR = 0.1
"""Smallest share of the lamps' amplitude that an exposure must see for their own amplitude to be computed."""


@dataclass(frozen=True)
class Flicker:
    """The flicker at one exposure time."""

    hz: float
    """The likelier of `FREQUENCIES_HZ`."""
    amplitude: float
    """Of the picture's brightness, relative to its mean."""
    error: float
    """Standard error of the amplitude."""
    exposure_us: float

    @property
    def is_seen(self) -> bool:
        """Whether the pictures flicker."""
        return self.amplitude > max(SEEN, SURE * self.error)

    @property
    def of_lamps(self) -> float | None:
        """Amplitude of the lamps' own light, relative to its mean; None where the exposure averages it away."""
        share = abs(float(np.sinc(self.hz * 1e-6 * self.exposure_us)))
        return self.amplitude / share if share > CLEAR else None

    @property
    def quiet_us(self) -> float:
        """The nearest exposure time without flicker [us]."""
        period = 1e6 / self.hz
        return max(round(self.exposure_us / period), 1) * period

    @property
    def line(self) -> str:
        """For a person."""
        if not self.is_seen:
            found = f"{100 * self.amplitude:.2f} % +- {100 * self.error:.2f} %"
            return f"flicker    none seen: {found} at {1e-3 * self.exposure_us:.3g} ms"
        lamps = "" if self.of_lamps is None else f", of the lamps {100 * self.of_lamps:.0f} %"
        advice = f"expose for {1e-3 * self.quiet_us:.4g} ms or a multiple of {1e3 / self.hz:.4g} ms"
        return f"flicker    {100 * self.amplitude:.1f} % of the light at {self.hz:g} Hz{lamps}: {advice}"


def burst(
    camera: Camera,
    part: Part,
    count: int,
    advance: Callable[[], None] = lambda: None,
    response: Response | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Times (count,) [s], brightness (count, BANDS) and exposure time [us] of pictures with irregular pauses.

    Regular ones could hit the same phase of the lamps each time. The camera's clock is used where it has one. `response` takes
    away the black level, which else counts as light that does not flicker.
    """
    rng, times, levels, exposure_us = np.random.default_rng(0), [], [], 0.0
    for _ in range(count):
        time.sleep(rng.uniform(0, 1 / FREQUENCIES_HZ[0]))
        image = camera.grab()
        values = values_of(image)
        signal = part.of(values if response is None else response.signal(values)).mean(-1)
        good = np.where(part.of(values).max(-1) < SATURATED, signal, np.nan)
        levels.append([float(np.nanmean(band)) if np.isfinite(band).any() else 1.0 for band in np.array_split(good, BANDS)])
        times.append(1e-9 * (image.device_ticks or image.host_time_ns))
        exposure_us = image.exposure_us
        advance()
    return np.array(times), np.array(levels), exposure_us


def flicker(times: NDArray[np.float64], levels: NDArray[np.float64], exposure_us: float) -> Flicker:
    """The flicker of a burst; arguments as `burst` returns them."""
    relative = levels / np.maximum(levels.mean(0), 1e-9)
    fits = {hz: _fitted(times - times[0], relative, hz) for hz in FREQUENCIES_HZ}
    hz = min(fits, key=lambda one: fits[one][2])
    amplitude, error, _ = fits[hz]
    return Flicker(hz, amplitude, error, exposure_us)


def _fitted(times: NDArray[np.float64], relative: NDArray[np.float64], hz: float) -> tuple[float, float, float]:
    """Amplitude, its standard error, and the remaining sum of squares of all bands."""
    turns = 2 * np.pi * hz * times
    design = np.stack([np.ones_like(turns), np.cos(turns), np.sin(turns)], -1)
    found, *_ = np.linalg.lstsq(design, relative, rcond=None)
    left = float(np.sum((relative - design @ found) ** 2))
    noise = left / max(relative.size - 3 * relative.shape[1], 1)
    amplitude = float(np.sqrt(np.mean((found[1] ** 2 + found[2] ** 2) / found[0] ** 2)))
    return amplitude, float(np.sqrt(2 * noise / len(times))), left
