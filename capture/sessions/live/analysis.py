"""Figures of one picture: focus over a region, clipped pixels, the exposure that would suit."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.measurements import Image
from koala3d.capture.recording.focus import sharpness
from koala3d.capture.sessions.live.flat import values_of
from koala3d.datasets.radiometry.merge import SATURATED

MAY_CLIP = 0.001
"""Share of the pixels that may be brighter than `WANTED` of the largest value at the suggested exposure."""
WANTED = 0.8
DARKER = 8.0
"""A picture that clips too much says only that its exposure is too long: the next one to try is shorter by this factor."""


@dataclass(frozen=True)
class Part:
    """A rectangle of a picture in pixels: [left, right) x [top, bottom)."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def middle(cls, width: int, height: int) -> "Part":
        """Half the width and height, in the middle."""
        return cls(width // 4, height // 4, width - width // 4, height - height // 4)

    def of(self, picture: NDArray) -> NDArray:
        """That part of (height, width, ...) values."""
        return picture[self.top : self.bottom, self.left : self.right]


@dataclass(frozen=True)
class Look:
    """What one picture says."""

    focus: float
    """Sharpness over the region, as `capture check` has it; larger is sharper."""
    clipped: float
    """Share of pixels with a channel at `SATURATED` of the largest value, of the whole picture."""
    exposure_us: float
    suggested_us: float
    """Exposure time at which `MAY_CLIP` of the region's pixels would exceed `WANTED` of the largest value."""
    too_bright: bool
    """Whether so much is clipped that the suggestion is only the next time to try."""

    @classmethod
    def at(cls, image: Image, part: Part) -> "Look":
        """The figures of a picture."""
        values = values_of(image).max(-1)
        bright = float(np.quantile(part.of(values), 1 - MAY_CLIP))
        too_bright = bright >= SATURATED
        factor = 1 / DARKER if too_bright else min(WANTED / max(bright, 1e-3), DARKER)
        clipped = float((values >= SATURATED).mean())
        return cls(sharpness(part.of(image.pixels)), clipped, image.exposure_us, image.exposure_us * factor, too_bright)

    @property
    def lines(self) -> list[str]:
        """For a person."""
        suggested = f"{1e-3 * self.suggested_us:.3g} ms"
        advice = f"too bright: try {suggested}, or brackets" if self.too_bright else f"suggested {suggested}"
        return [
            f"focus      {self.focus:.3f} (larger is sharper)",
            f"clipped    {100 * self.clipped:.2f} % of the pixels",
            f"exposure   {1e-3 * self.exposure_us:.3g} ms; {advice}",
        ]
