"""What real sensors, lamps and arms do besides: black level, vignetting, uneven and hot pixels, unbalanced channels, flicker,
noise of encoders, drift.

All but the noise of encoders are off by default. `configs/rigs/sim_flawed.yaml` switches them on. The description and the seed
are the truth.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from koala3d.datasets.core.schema import Schema
from koala3d.datasets.imaging.region import Region

RATES = (0.02, 0.6)
"""Dark current of a hot pixel [full wells in 10 ms], drawn evenly in the logarithm."""
REFERENCE_US = 10_000.0


class Flaws(Schema):
    """Flaws of the simulated sensor, lens, lamps and arm."""

    black_level: float = Field(default=0.0, ge=0, lt=0.5, description="value without light [share of the largest value]")
    vignetting: float = Field(default=0.0, ge=0, lt=1, description="share of the light that is lost in the sensor's corners")
    unevenness: float = Field(default=0.0, ge=0, lt=0.2, description="standard deviation of the response of pixels, relative")
    hot_share: float = Field(default=0.0, ge=0, lt=0.1, description="share of pixels that glow without light")
    sums_columns: bool = Field(
        default=False, description="binned columns are added up and rows averaged, as an acA1920-25uc does; false: both averaged"
    )
    channels: tuple[float, float, float] = Field(
        default=(1.0, 1.0, 1.0), description="response to red, green and blue light; a grey card is grey where they are equal"
    )
    flicker_hz: float = Field(default=100.0, gt=0, description="frequency of the lamps' light: twice that of the mains [Hz]")
    encoder_noise_rad: float = Field(
        default=4e-6, ge=0, le=1e-3, description="standard deviation of the angles that the arm's encoders measure [rad]"
    )
    flicker: float = Field(default=0.0, ge=0, lt=1, description="amplitude of the lamps' flicker, relative to their light")
    drift_mm: float = Field(default=0.0, ge=0, le=10, description="by how much warming up moves the flange in the end [mm]")
    drift_minutes: float = Field(
        default=20.0, gt=0, description="within which it covers 63 % of that, on the clock of the arm's controller [min]"
    )


@dataclass(frozen=True)
class SensorMaps:
    """Flaws of the pixels of a region."""

    response: NDArray[np.float32]  # (height, width, 3) value per light
    glow: NDArray[np.float32]  # (height, width, 1) dark current [full wells in `REFERENCE_US`]

    @classmethod
    def of(cls, flaws: Flaws, region: Region, sensor: tuple[int, int], seed: int) -> "SensorMaps":
        """Those of a region of a sensor of (width, height) pixels. A pixel has the same flaws in every region."""
        rng, (width, height), b = np.random.default_rng([seed, 21]), sensor, region.binning
        uneven = rng.normal(1.0, 1.0, (height, width)) if flaws.unevenness else np.ones((height, width))
        uneven = 1 + flaws.unevenness * (uneven - 1)
        glow = np.zeros((height, width))
        count = int(flaws.hot_share * width * height)
        glow.flat[rng.choice(width * height, count, replace=False)] = np.exp(rng.uniform(*np.log(RATES), count))
        rows, columns = np.mgrid[:height, :width] + 0.5
        reach = np.hypot(columns - width / 2, rows - height / 2) / np.hypot(width / 2, height / 2)
        seen = uneven * (1 - flaws.vignetting * reach**2)
        part = np.s_[
            region.offset_y * b : (region.offset_y + region.height) * b,
            region.offset_x * b : (region.offset_x + region.width) * b,
        ]
        seen, glow = (_binned(values[part], b).astype(np.float32) for values in (seen, glow))
        return cls(seen[..., None] * np.array(flaws.channels, np.float32), glow[..., None])


def _binned(values: NDArray[np.float64], b: int) -> NDArray[np.float64]:
    height, width = values.shape
    return values.reshape(height // b, b, width // b, b).mean(axis=(1, 3))


def lamp_light(flaws: Flaws, time_s: float, exposure_s: float) -> float:
    """Mean light of the lamps during an exposure that starts at `time_s`, relative to their mean."""
    turns = flaws.flicker_hz * exposure_s
    return 1 + flaws.flicker * float(np.sinc(turns) * np.cos(2 * np.pi * flaws.flicker_hz * (time_s + exposure_s / 2)))
