"""Features of one picture: places that can be found again in other pictures, their descriptors and their colours.

SIFT in a picture of at most `SIDE` pixels. Descriptors are stored as COLMAP's, so that its matcher takes them: times 512.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import arrays, files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images, reduced, sift
from koala3d.datasets.process.pictures import markers
from koala3d.datasets.process.pictures.markers import Marker

SIDE = 1200
"""Longest side of the pictures that are searched [px]."""
COUNT = 4000
"""Features per picture; those of the highest contrast are kept."""


@dataclass(frozen=True, eq=False)
class PictureFeatures:
    """Features of one picture, in the pixels of the smaller picture that was searched."""

    width: int
    height: int
    pixels: NDArray[np.float32]
    """(n, 2) in the upright picture, those of the highest contrast first."""
    descriptors: NDArray[np.uint8]
    """(n, 128)."""
    colours: NDArray[np.uint8]
    """(n, 3) sRGB."""
    markers: tuple[Marker, ...]
    """Printed markers that the picture may show."""

    def save(self, path: Path) -> None:
        """Write to a file, atomically."""
        content = {"size": np.array([self.width, self.height]), "pixels": self.pixels, "descriptors": self.descriptors}
        content |= {"colours": self.colours, "kinds": np.array([marker.kind for marker in self.markers], np.str_)}
        content |= {"corners": np.array([marker.corners for marker in self.markers], np.float64).reshape(-1, 4, 2)}
        with files.atomic_path(path) as temporary:
            np.savez(temporary, allow_pickle=False, **content)

    @classmethod
    def load(cls, path: Path) -> "PictureFeatures":
        """Read `save`'s file. Raises DatasetError where it is damaged."""
        stored = arrays.read_npz(path)
        try:
            kinds = [str(kind) for kind in stored["kinds"]]
            found = tuple(Marker(kind, corners) for kind, corners in zip(kinds, stored["corners"], strict=True))
            width, height = map(int, stored["size"])
            return cls(width, height, stored["pixels"], stored["descriptors"], stored["colours"], found)
        except (KeyError, ValueError) as error:
            raise DatasetError("features are not complete", where=path, why=str(error), remedy="remove it") from None


def detect(path: Path) -> PictureFeatures:
    """Features and markers of an image file; where it has an alpha, only where that is opaque. Raises as `images.read` does."""
    picture, mask = _searched(path)
    return replace(detect_in(picture, mask), markers=tuple(markers.detect(_grey(picture))))


def detect_in(picture: NDArray[np.uint8], mask: NDArray[np.uint8] | None) -> PictureFeatures:
    """Features of a (height, width, 3) picture, if there is a mask only where it is white."""
    height, width = picture.shape[:2]
    found = sift.keypoints(_grey(picture), mask, COUNT)
    order = np.argsort(-found.contrast, kind="stable")
    descriptors = np.rint(512 * found.descriptors[order]).clip(0, 255).astype(np.uint8)
    colours = picture[found.inside(width, height)][order]
    return PictureFeatures(width, height, found.pixels[order].astype(np.float32), descriptors, colours, ())


def _grey(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)


def markers_of(path: Path) -> tuple[Marker, ...]:
    """Printed markers in an image file, in its own pixels. Raises as `images.read` does."""
    picture, _ = _searched(path)
    width, height = images.size(path)
    ratio = np.array([width / picture.shape[1], height / picture.shape[0]])
    return tuple(Marker(marker.kind, marker.corners * ratio) for marker in markers.detect(_grey(picture)))


def _searched(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    """(height, width, 3) sRGB bytes of at most `SIDE` pixels, and the mask of an alpha."""
    import cv2

    width, height = images.size(path)
    shrink = max(1.0, max(height, width) / SIDE)
    size = max(round(width / shrink), 1), max(round(height / shrink), 1)
    stored = _bytes(reduced.read_stored(path, *size))
    small: Any = stored if shrink == 1 else cv2.resize(stored, size, interpolation=cv2.INTER_AREA)
    small = small.reshape(size[1], size[0], -1)
    mask = np.where(small[..., -1] > 127, 255, 0).astype(np.uint8) if small.shape[-1] in (2, 4) else None
    colours = np.repeat(small[..., :1], 3, axis=-1) if small.shape[-1] < 3 else small[..., :3]
    return np.ascontiguousarray(colours), mask


def _bytes(stored: NDArray[Any]) -> NDArray[np.uint8]:
    """A picture as bytes, from bytes, 16 bits or floats in 0..1; black where a float is NaN."""
    if stored.dtype == np.uint8:
        return stored
    if stored.dtype == np.uint16:
        return (stored >> 8).astype(np.uint8)
    return images.to_uint8(np.where(np.isnan(stored), np.float32(0), stored))
