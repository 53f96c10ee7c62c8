"""What a sensor makes of light, as `capture flat` measures it: black level, flat field, white balance, hot pixels, noise.

    value = black + (1 - black) * flat * light / balance      (1 is the largest value; light is 1 where green saturates)

A plane is what has its own colour filter: the four places of a mosaic's 2 x 2 pattern, the three channels of a colour picture,
or the whole of a grey one. A value for each plane is an array (period, period, channels), see `mosaic.tiled`.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import arrays, files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.radiometry.mosaic import tiled

FORMAT, VERSION = "koala-radiometry", 1
GAIN_DB = 0.05  # gains that differ by less are the same [dB]
STORED = {"black": np.float64, "balance": np.float64, "flat": np.float16, "hot": np.int32}
NOMINAL_SHOT, NOMINAL_READ = 1e-4, 1e-3
"""Noise of a small sensor that nobody has measured: a well of 10 000 electrons, and 10 of them read noise."""


@dataclass(frozen=True)
class Response:
    """The response of one camera at one gain, in one region of its sensor. All values are shares of the largest value."""

    serial: str
    pixel_format: str
    """GenICam name, such as "BayerRG12"."""
    region: Region
    gain_db: float
    black: NDArray[np.float64]
    """(period, period, channels) value without light."""
    balance: NDArray[np.float64]
    """(period, period, channels) factors that make a grey card grey; 1 for green."""
    flat: NDArray[np.float16]
    """(height, width, channels) value of an evenly lit card, 1 in the middle of the picture."""
    hot: NDArray[np.int32]
    """(n, 2) rows and columns of pixels that glow without light or hardly see any."""
    shot: float
    """Variance of a value that light adds, per value: 1 / electrons of a full pixel."""
    read: float
    """Standard deviation of a value without light."""
    black_level: float = 0.0
    """What a setting of the camera had added to `black` while it was measured."""

    @classmethod
    def unmeasured(cls, height: int, width: int, planes: tuple[int, int, int]) -> Self:
        """A perfect sensor with nominal noise, for recordings without a measurement."""
        one = np.ones(planes)
        flat, hot = np.ones((height, width, planes[-1]), np.float16), np.zeros((0, 2), np.int32)
        return cls("", "", Region(width, height), 0.0, 0 * one, one, flat, hot, NOMINAL_SHOT, NOMINAL_READ)

    def save(self, path: Path) -> None:
        """Write a .npz file with a checksum of its content."""
        parts = {name: np.ascontiguousarray(getattr(self, name), kind) for name, kind in STORED.items()}
        about = {
            "format": FORMAT,
            "version": VERSION,
            "serial": self.serial,
            "pixel_format": self.pixel_format,
            "region": self.region.to_json(),
            "gain_db": self.gain_db,
            "shot": self.shot,
            "read": self.read,
            "black_level": self.black_level,
            "sha256": _digest(parts),
        }
        with files.atomic_path(Path(path)) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, allow_pickle=False, about=np.array(json.dumps(about, allow_nan=False)), **parts)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a file of `save`.

        Raises:
            UsageError: there is none.
            DatasetError: it is another file, damaged, or of a newer version.
        """
        stored = arrays.read_npz(Path(path))
        remedy = "record it again with 'capture flat'"
        try:
            about = json.loads(str(stored["about"]))
            if about["format"] != FORMAT:
                raise ValueError(f"its format says {about['format']!r}")
            if about["version"] != VERSION:
                what, why = f"{FORMAT} version {about['version']} cannot be read", f"this Koala reads version {VERSION}"
                raise DatasetError(what, where=path, why=why, remedy="use the Koala version that wrote it")
            parts = {name: stored[name] for name in STORED}
            if _digest(parts) != about["sha256"]:
                raise ValueError("its checksum is wrong")
            region = Region.from_json(about["region"], where=path)
            numbers = {name: float(about[name]) for name in ("gain_db", "shot", "read")}
            numbers["black_level"] = float(about.get("black_level", 0.0))  # older files were measured without one
            found = cls(str(about["serial"]), str(about["pixel_format"]), region, **numbers, **parts)
            found._check()
        except (KeyError, TypeError, ValueError) as error:
            raise DatasetError("is not a measured response", where=path, why=str(error), remedy=remedy) from None
        return found

    def _check(self) -> None:
        height, width, channels = self.flat.shape
        if (width, height) != (self.region.width, self.region.height):
            raise ValueError(f"its flat field is {width}x{height}, its region {self.region.width}x{self.region.height}")
        for name in ("black", "balance"):
            planes = getattr(self, name)
            if planes.shape not in {(1, 1, channels), (2, 2, 1)} or not np.isfinite(planes).all():
                raise ValueError(f"{name} has the shape {planes.shape}")
        good = (self.flat > 0).all() and np.isfinite(self.flat).all() and (self.black < 1).all() and (self.balance > 0).all()
        if not good or self.hot.ndim != 2 or not ((self.hot >= 0) & (self.hot < [height, width])).all():
            raise ValueError("its values are impossible")
        if not (self.shot > 0 and self.read > 0):
            raise ValueError("its noise is impossible")

    def of_camera(self, camera: dict[str, Any], *, where: object) -> Self:
        """This response at the black level of its camera, as a recording's manifest describes it.

        Raises UsageError: it is the response of another camera, format, region or gain.
        """
        pairs = {
            "serial number": (self.serial, camera.get("serial")),
            "pixel format": (self.pixel_format, camera.get("pixel_format")),
            "sensor region": (self.region.to_json(), camera.get("region")),
        }
        for name, (ours, theirs) in pairs.items():
            if ours != theirs:
                why = f"measured with {ours}, recorded with {theirs}"
                raise UsageError(f"is the response for another {name}", where=where, why=why, remedy="measure it: 'capture flat'")
        gain = camera.get("gain_db")
        if not isinstance(gain, int | float) or abs(gain - self.gain_db) > GAIN_DB:
            why = f"measured with {self.gain_db:g} dB, recorded with {gain} dB"
            raise UsageError("is the response for another gain", where=where, why=why, remedy="measure it: 'capture flat'")
        added = added_black(camera)
        return replace(self, black=self.black + (added - self.black_level), black_level=added)

    def signal(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Values without the black level and without hot pixels, 1 for the largest; (height, width, channels) as `flat`."""
        height, width = values.shape[:2]
        black = tiled(self.black, height, width)
        return self._mended(((values - black) / (1 - black)).astype(np.float32))

    def light(self, signal: NDArray[np.float32]) -> NDArray[np.float32]:
        """Light from `signal`: evened out by the flat field and balanced. The same factors apply to standard deviations."""
        balance = tiled(self.balance, *signal.shape[:2])
        return (signal * (balance / self.flat.astype(np.float32))).astype(np.float32)

    def _mended(self, signal: NDArray[np.float32]) -> NDArray[np.float32]:
        """Hot pixels replaced by the median of the good ones among the eight next pixels of the same plane."""
        if not len(self.hot):
            return signal
        period, (height, width) = self.black.shape[0], signal.shape[:2]
        steps = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if (down, right) != (0, 0)]
        places = self.hot[:, None] + period * np.array(steps)  # (n, 8, 2)
        inside = ((places >= 0) & (places < [height, width])).all(-1)
        rows, columns = np.moveaxis(np.where(inside[..., None], places, 0), -1, 0)
        bad = np.zeros((height, width), bool)
        bad[self.hot[:, 0], self.hot[:, 1]] = True
        good = inside & ~bad[rows, columns]
        mended, usable = signal.copy(), good.any(1)
        near = np.ma.array(signal[rows, columns], mask=np.repeat(~good[..., None], signal.shape[-1], -1))
        middle = np.ma.median(near, axis=1).filled(0)
        mended[self.hot[usable, 0], self.hot[usable, 1]] = middle[usable]
        return mended


def added_black(camera: Mapping[str, Any]) -> float:
    """What a camera's description says that a setting adds to every value [share of the largest value]; 0 if it does not say."""
    return float(camera.get("black_level") or 0.0)


def _digest(parts: dict[str, NDArray[Any]]) -> str:
    found = hashlib.sha256()
    for name, part in sorted(parts.items()):
        found.update(f"{name} {part.dtype.str} {part.shape}".encode())
        found.update(np.ascontiguousarray(part).tobytes())
    return found.hexdigest()
