"""From the light that a perfect pinhole sees to the picture that a real lens and sensor deliver.

A renderer knows pinholes only. `Lens` says which pinhole picture it needs (finer and a little wider than the real one) and
averages it over each pixel of the distorting camera. `expose` then counts electrons: shot noise, read noise, 8 or 12 bits.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from datasets.camera_model import Camera
from datasets.imaging.images import srgb_from_linear, to_uint8

Picture = NDArray[np.float32]
MARGIN = 1
"""Camera pixels that the pinhole sees beyond the border, for interpolation."""


@dataclass(frozen=True)
class Lens:
    """Resamples pinhole pictures to those of `camera`."""

    camera: Camera
    supersampling: int = 2
    """Pixels of the pinhole picture per pixel of the camera, along each axis."""
    taps: int = 3
    """Each pixel averages taps x taps places, so that edges are soft as on a sensor."""

    @cached_property
    def _corners(self) -> NDArray[np.float64]:
        """(height + 1, width + 1, 2) ideal normalised coordinates of the pixels' corners."""
        columns, rows = np.meshgrid(np.arange(self.camera.width + 1.0), np.arange(self.camera.height + 1.0))
        return self.camera.directions(np.stack([columns, rows], -1))[..., :2]

    @cached_property
    def pinhole(self) -> Camera:
        """The pinhole whose picture covers everything that the camera sees, its centre on a pixel's corner."""
        focal = max(self.camera.fx, self.camera.fy)
        lower = np.floor(self._corners.min(axis=(0, 1)) * focal).astype(int) - MARGIN
        upper = np.ceil(self._corners.max(axis=(0, 1)) * focal).astype(int) + MARGIN
        width, height = (int(edge) for edge in (upper - lower) * self.supersampling)
        centre = -lower * float(self.supersampling)
        return Camera(width, height, focal * self.supersampling, focal * self.supersampling, float(centre[0]), float(centre[1]))

    def places(self) -> Iterator[NDArray[np.float64]]:
        """taps * taps times (height, width, 2): ideal normalised coordinates spread evenly over each pixel.

        Inside a pixel the lens is taken as bilinear between the corners, which is good to 1e-4 px.
        """
        shares = (np.arange(self.taps) + 0.5) / self.taps
        upper, lower = self._corners[:-1], self._corners[1:]
        for down in shares:
            edge = (1 - down) * upper + down * lower
            for right in shares:
                yield (1 - right) * edge[:, :-1] + right * edge[:, 1:]

    def middles(self) -> NDArray[np.float64]:
        """(height, width, 2) ideal normalised coordinates of the pixels' middles."""
        corners = self._corners
        return (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:]) / 4

    def image(self, picture: Picture) -> Picture:
        """(height, width, channels) means over the camera's pixels of a picture taken by `pinhole`."""
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            total = sum(pool.map(partial(self._seen, picture), self.places()))
        return np.asarray(total / self.taps**2, np.float32)

    def _seen(self, picture: Picture, place: NDArray[np.float64]) -> Picture:
        """(height, width, channels) of the pinhole's picture at (height, width, 2) ideal coordinates, interpolated."""
        from scipy.ndimage import map_coordinates

        pinhole = self.pinhole
        columns, rows = np.moveaxis(place * pinhole.fx + [pinhole.cx - 0.5, pinhole.cy - 0.5], -1, 0)
        channels = np.moveaxis(picture, -1, 0)
        return np.stack([map_coordinates(channel, [rows, columns], order=1, mode="nearest") for channel in channels], -1)


def strips(pinhole: Camera, pixels: int) -> Iterator[tuple[slice, Camera]]:
    """Parts of a pinhole's picture that need less memory: rows, and the pinhole that sees only these, at most `pixels`."""
    height = max(pixels // pinhole.width, 1)
    for first in range(0, pinhole.height, height):
        last = min(first + height, pinhole.height)
        yield slice(first, last), replace(pinhole, height=last - first, cy=pinhole.cy - first)


@dataclass(frozen=True)
class Sensor:
    """How light becomes numbers."""

    full_well: float = 8000.0
    """Electrons of one photosite at saturation."""
    read_noise: float = 6.0
    """Standard deviation of reading one photosite [electrons]."""
    saturation: float = 1.5
    """Radiance that fills the well in `reference_us` at 0 dB."""
    reference_us: float = 10000.0

    def expose(
        self, radiance: Picture, *, exposure_us: float, gain_db: float, binning: int, rng: np.random.Generator, raw_bits: int = 0
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """(height, width, 3) sRGB bytes of linear light; with `raw_bits` what the converter counts, linear, in the upper bits
        of 16. Binned photosites average, so noise falls by `binning`."""
        sites = binning**2
        share = radiance / self.saturation * (exposure_us / self.reference_us)
        electrons = np.minimum(np.maximum(share, 0), 1.0) * self.full_well * sites
        noisy = rng.poisson(electrons) + rng.normal(0.0, self.read_noise * binning, electrons.shape)
        amplified = noisy / (self.full_well * sites) * 10 ** (gain_db / 20)
        shares = np.clip(amplified, 0.0, 1.0)
        if not raw_bits:
            return to_uint8(srgb_from_linear(shares))
        return (np.rint(shares * (2**raw_bits - 1)).astype(np.uint16) << (16 - raw_bits)).astype(np.uint16)

    def white(self, exposure_us: float, gain_db: float) -> float:
        """Radiance that becomes white: what a picture has lost by clipping lies above it."""
        return self.saturation * self.reference_us / exposure_us / 10 ** (gain_db / 20)
