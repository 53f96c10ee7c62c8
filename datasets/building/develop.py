"""From the exposures of a recorded frame to the picture of a scene: evened out, balanced, merged, in colour."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images
from koala3d.datasets.radiometry import stored
from koala3d.datasets.radiometry.merge import SATURATED, merge
from koala3d.datasets.radiometry.mosaic import demosaiced, pattern_of
from koala3d.datasets.radiometry.response import Response
from koala3d.datasets.radiometry.stored import Exposure
from koala3d.datasets.recording import Frame, Recording
from koala3d.datasets.scene import View

BEYOND_WHITE = 0.001
"""Share of the pixels of a merged picture that may be brighter than white."""
LARGEST_HALF = 6e4
"""Brighter light is stored as this, which half floats can still hold."""


@dataclass(frozen=True)
class Developed:
    """The picture of one frame. Light is 1 where green saturates in the longest exposure."""

    light: NDArray[np.float32]
    """(height, width, 3 or 1) linear light."""
    deviation: NDArray[np.float32] | None
    """Its standard deviation, of a bracket; None of a single exposure."""
    clipped: tuple[float, float]
    """Shares of pixels with a channel that is saturated in the longest exposure, and in all of them."""


def develop(recording: Recording, frame: Frame, response: Response | None) -> Developed:
    """The picture of a frame.

    Raises DatasetError: a file is missing, altered or damaged, or of another size than the response.
    """
    taken = frame.exposures or (Exposure(frame.image, frame.exposure_us, frame.sha256),)
    raw = stored.is_raw(taken[0].file)
    values = [_read(recording, frame, one, raw) for one in taken]
    height, width, channels = values[0].shape
    pattern = pattern_of(str(recording.part("camera").get("pixel_format"))) if raw else ""
    if response is None:
        response = Response.unmeasured(height, width, (2, 2, 1) if pattern else (1, 1, channels))
    if any(value.shape != response.flat.shape for value in values):
        why = f"it is {width}x{height}x{channels}, the flat field {'x'.join(map(str, response.flat.shape))} (height first)"
        raise DatasetError("picture does not fit the measured response", where=f"{recording.path}, frame {frame.name}", why=why)
    if len(values) == 1:
        light, deviation, clipped = response.light(response.signal(values[0])), None, values[0] >= SATURATED
    else:
        merged = merge(values, [one.exposure_us for one in taken], response, raw=raw)
        light, deviation, clipped = response.light(merged.signal), response.light(merged.deviation), merged.clipped
    if pattern:
        light = demosaiced(light[..., 0], pattern)
        deviation = None if deviation is None else demosaiced(deviation[..., 0], pattern)
    shares = (float((values[0] >= SATURATED).any(-1).mean()), float(clipped.any(-1).mean()))
    return Developed(np.maximum(light, 0), deviation, shares)


class Development:
    """Develops the frames of a recording, where their pictures in the scene are not those of the recording."""

    def __init__(self, recording: Recording, response: Response | None, folder: Path) -> None:
        self.recording, self.response, self.folder = recording, response, folder
        self.brackets = max((len(frame.exposures) for frame in recording.frames), default=0)
        self._clipped: list[tuple[float, float]] = []
        self._bright: list[float] = []

    @property
    def is_needed(self) -> bool:
        """Whether there is a measured response, or a bracket to merge."""
        return self.response is not None or self.brackets > 1

    def picture(self, view: View, frame: Frame) -> View:
        """The view with its developed picture, which lies in the folder; unchanged where none is needed."""
        if not self.is_needed:
            return view
        developed = develop(self.recording, frame, self.response)
        self._clipped.append(developed.clipped)
        self._bright.append(float(np.quantile(developed.light.max(-1), 1 - BEYOND_WHITE)))
        image, deviation = write(developed, self.folder, frame.name)
        return replace(view, image=image, deviation=deviation)

    def finished(self, view: View, white: float | None) -> View:
        """The view of a bracket with its white: the given one, else what `BEYOND_WHITE` of the brightest view's pixels exceed."""
        if view.deviation is None:
            return view
        return replace(view, white=max(1.0, *self._bright) if white is None else white)

    @property
    def notes(self) -> list[str]:
        """What was done to the pictures, for the scene."""
        if not self.is_needed:
            return []
        how = ["black level, flat field and white balance are corrected"] if self.response else []
        how += [f"{self.brackets} exposures are merged"] if self.brackets > 1 else []
        first, every = 100 * np.mean(self._clipped, axis=0)
        clipped = f"{first:.3f} % of the pixels are clipped" + (
            f" in the longest, {every:.3f} % in all" if self.brackets > 1 else ""
        )
        return [f"{'; '.join(how)}; {clipped}"]


@contextmanager
def developing(recording: Recording, response: Response | None, out: Path) -> Iterator[Development]:
    """A development in a folder beside `out`, which is removed at the end."""
    development = Development(recording, response, Path(out))
    if not development.is_needed:
        yield development
        return
    home = Path(out).resolve().parent
    files.make_folder(home)
    with TemporaryDirectory(prefix=".developing-", dir=home) as folder:
        development.folder = Path(folder)
        yield development


def write(developed: Developed, folder: Path, name: str) -> tuple[Path, Path | None]:
    """Write a picture: sRGB of 16 bits, or of a bracket linear light and its deviation as half floats.

    Returns:
        The picture, and the deviation of a bracket.
    """
    if developed.deviation is None:
        path = folder / f"{name}.png"
        images.write(path, images.to_uint16(images.srgb_from_linear(developed.light)))
        return path, None
    path, deviation = folder / f"{name}.exr", folder / f"{name}_deviation.exr"
    for place, values in ((path, developed.light), (deviation, developed.deviation)):
        images.write(place, np.minimum(values, LARGEST_HALF).astype(np.float16))
    return path, deviation


def _read(recording: Recording, frame: Frame, exposure: Exposure, raw: bool) -> NDArray[np.float32]:
    where = f"{recording.path}, frame {frame.name}"
    path = files.inside(recording.path, exposure.file, where=where)
    if exposure.sha256 and files.sha256(path) != exposure.sha256:
        why, remedy = "its SHA-256 differs from frames.jsonl", "restore it, or record the frame again"
        raise DatasetError("image is not the one that was recorded", where=path, why=why, remedy=remedy)
    return stored.read(path, raw=raw)
