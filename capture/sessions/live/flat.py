"""Measures the response of a camera: pictures of darkness, then of an evenly lit grey card."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.measurements import Image
from koala3d.capture.drivers.protocols import Camera, GroundTruth
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.radiometry.measure import Statistics, response
from koala3d.datasets.radiometry.response import Response, added_black
from koala3d.datasets.radiometry.stored import linear, packed

Advance = Callable[[], None]


def values_of(image: Image) -> NDArray[np.float32]:
    """(height, width, channels) linear values of a picture: the raw ones where the camera sends 12 bits."""
    if image.raw is None:
        return linear(image.pixels, raw=False)
    return linear(packed(image.raw)[..., None], raw=True)


def statistics(camera: Camera, count: int, advance: Advance) -> Statistics:
    """Mean and variance of `count` pictures, without keeping them."""

    def pictures() -> Iterator[NDArray[np.float32]]:
        for number in range(count):
            if hasattr(camera, "prepare"):
                prepared: GroundTruth = camera  # type: ignore[assignment]
                prepared.prepare(number)  # other noise in each picture of a simulation
            yield values_of(camera.grab())
            advance()

    return Statistics.of(pictures())


def measured(said: Mapping[str, Any], dark: Statistics, card: Statistics) -> Response:
    """The response of a camera with a description, from statistics of pictures that it took in darkness and of a card."""
    region = Region.from_json(said["region"], where="camera")
    name, gain = said["pixel_format"], float(said["gain_db"])
    found = response(dark, card, serial=said["serial"], pixel_format=name, region=region, gain_db=gain, raw=name.endswith("12"))
    return replace(found, black_level=added_black(said))


def words(found: Response, path: Path) -> str:
    """The result for a person."""
    black, balance = found.black.ravel(), found.balance.ravel()
    lines = [
        f"black level     {', '.join(f'{100 * value:.3f}' for value in black)} % of the largest value",
        f"white balance   {', '.join(f'{value:.4f}' for value in balance)}",
        f"flat field      {float(np.percentile(found.flat, 0.5)):.3f} to {float(np.percentile(found.flat, 99.5)):.3f}",
        f"hot pixels      {len(found.hot)} of {found.flat.shape[0] * found.flat.shape[1]}",
        f"noise           read {100 * found.read:.3f} % of the largest value, full pixel {1 / found.shot:.0f} electrons",
        f"written to {path}",
    ]
    return "\n".join(lines)
