"""From the picture of an ideal pinhole to that of a real lens and sensor.

The renderer supports only pinholes. `Lens` defines the pinhole picture that it needs (finer and slightly wider than the real
one) and averages it over each pixel of the distorted camera. `Sensor.expose` adds shot noise and read noise, and quantises.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.flaws import SensorMaps
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging.images import srgb_from_linear, to_uint8

Picture = NDArray[np.floating]
MARGIN = 1  # pixels that the pinhole picture extends beyond the border of the camera, for interpolation


@dataclass(frozen=True)
class Lens:
    """Resamples pinhole pictures to the distorted pixels of `camera`."""

    camera: Camera
    supersampling: int = 2  # pixels of the pinhole picture per pixel of the camera, along each axis
    taps: int = 3  # each pixel averages taps x taps samples, so that edges are as soft as on a sensor

    @cached_property
    def _corners(self) -> NDArray[np.float64]:
        """(height + 1, width + 1, 2) undistorted normalised coordinates of the pixel corners."""
        columns, rows = np.meshgrid(np.arange(self.camera.width + 1.0), np.arange(self.camera.height + 1.0))
        return self.camera.directions(np.stack([columns, rows], -1))[..., :2]

    @cached_property
    def pinhole(self) -> Camera:
        """The pinhole that covers the view of the camera, with its principal point on the corner of a pixel."""
        focal = max(self.camera.fx, self.camera.fy)
        lower = np.floor(self._corners.min(axis=(0, 1)) * focal).astype(int) - MARGIN
        upper = np.ceil(self._corners.max(axis=(0, 1)) * focal).astype(int) + MARGIN
        width, height = (int(edge) for edge in (upper - lower) * self.supersampling)
        centre = -lower * float(self.supersampling)
        return Camera(width, height, focal * self.supersampling, focal * self.supersampling, float(centre[0]), float(centre[1]))

    def places(self) -> Iterator[NDArray[np.float64]]:
        """taps * taps arrays (height, width, 2) of undistorted normalised coordinates, spread evenly over each pixel.

        Inside a pixel the distortion is interpolated bilinearly between the corners, which is accurate to 1e-4 px.
        """
        shares = (np.arange(self.taps) + 0.5) / self.taps
        upper, lower = self._corners[:-1], self._corners[1:]
        for down in shares:
            edge = (1 - down) * upper + down * lower
            for right in shares:
                yield (1 - right) * edge[:, :-1] + right * edge[:, 1:]

    def middles(self) -> NDArray[np.float64]:
        """(height, width, 2) undistorted normalised coordinates of the pixel centres."""
        corners = self._corners
        return (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:]) / 4

    def image(self, picture: Picture) -> NDArray[np.float32]:
        """(height, width, channels) means over the pixels of the camera of a picture of `pinhole`."""
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            total = sum(pool.map(partial(self._seen, picture), self.places()))
        return np.asarray(total / self.taps**2, np.float32)

    def _seen(self, picture: Picture, place: NDArray[np.float64]) -> Picture:
        """(height, width, channels) pinhole picture, interpolated at (height, width, 2) normalised coordinates."""
        from scipy.ndimage import map_coordinates

        pinhole = self.pinhole
        columns, rows = np.moveaxis(place * pinhole.fx + [pinhole.cx - 0.5, pinhole.cy - 0.5], -1, 0)
        channels = np.moveaxis(picture, -1, 0)
        return np.stack([map_coordinates(channel, [rows, columns], order=1, mode="nearest") for channel in channels], -1)


def strips(pinhole: Camera, pixels: int) -> Iterator[tuple[slice, Camera]]:
    """Horizontal strips of a pinhole picture with at most `pixels` each: the rows, and the pinhole that sees only these."""
    height = max(pixels // pinhole.width, 1)
    for first in range(0, pinhole.height, height):
        last = min(first + height, pinhole.height)
        yield slice(first, last), replace(pinhole, height=last - first, cy=pinhole.cy - first)


@dataclass(frozen=True)
class Sensor:
    """An image sensor: from light to pixel values."""

    full_well: float = 8000.0  # electrons of one sensor pixel at saturation
    read_noise: float = 6.0  # standard deviation of the read noise of one sensor pixel [electrons]
    saturation: float = 1.5  # radiance that fills the well in `reference_us` at 0 dB
    reference_us: float = 10000.0
    black_level: float = 0.0  # value without light [share of the largest value]

    def expose(
        self,
        radiance: Picture,
        *,
        exposure_us: float,
        gain_db: float,
        binning: int,
        rng: np.random.Generator,
        raw_bits: int = 0,
        maps: SensorMaps | None = None,
        binning_gain: int = 1,
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """(height, width, channels) sRGB bytes of linear light; with `raw_bits` linear values in the upper bits of 16.

        Binning averages sensor pixels, which reduces the noise by the factor `binning`; values are `binning_gain` times that
        average where a camera adds pixels up. `maps` are flaws of the pixels.
        """
        sites = binning**2
        share = radiance / self.saturation * (exposure_us / self.reference_us)
        if maps is not None:
            share = share * (maps.response if share.shape[-1] == 3 else maps.response[..., 1:2]) + maps.glow * (
                exposure_us / self.reference_us
            )
        electrons = np.minimum(np.maximum(share, 0), 1.0) * self.full_well * sites
        noisy = rng.poisson(electrons) + rng.normal(0.0, self.read_noise * binning, electrons.shape)
        amplified = noisy / (self.full_well * sites) * binning_gain * 10 ** (gain_db / 20)
        shares = np.clip(self.black_level + (1 - self.black_level) * amplified, 0.0, 1.0)
        if not raw_bits:
            return to_uint8(srgb_from_linear(shares))
        return (np.rint(shares * (2**raw_bits - 1)).astype(np.uint16) << (16 - raw_bits)).astype(np.uint16)

    def white(self, exposure_us: float, gain_db: float, binning_gain: int = 1) -> float:
        """Radiance that becomes white; a picture is clipped above it."""
        return self.saturation * self.reference_us / exposure_us / binning_gain / 10 ** (gain_db / 20)
