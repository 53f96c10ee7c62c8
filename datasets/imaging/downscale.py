"""Shrinking image files by area averages of linear light; bit depth and metadata are kept.

Each worker holds one image at a time, so memory does not grow with their number.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.pixels import resize_light

Item = TypeVar("Item")
Result = TypeVar("Result")


def camera(full: Camera, factor: int) -> Camera:
    """The camera of an image at 1/`factor` of its size, rounded down to whole pixels: nerfstudio accepts no others."""
    return full.scaled(max(full.width // factor, 1), max(full.height // factor, 1))


def shrunk(path: Path, width: int, height: int, *, colours: bool = True) -> NDArray[Any]:
    """(height, width, channels) of an image file at another size, with the bit depth of the file: uint8, uint16 or float32.

    Args:
        path: file to read. Integers are sRGB, floats linear light; a second or fourth channel is a straight alpha.
        width: new width [px].
        height: new height [px].
        colours: False for masks and depth, whose values are averaged as they are.
    """
    stored = images.read_stored(path)
    if not colours:
        top = 1.0 if stored.dtype == np.float32 else float(np.iinfo(stored.dtype).max)
        small = images.resize(stored.astype(np.float32) / np.float32(top), width, height, srgb=False)
    else:
        small = resize_light(images.linear_from_stored(stored), width, height)
        if stored.dtype != np.float32:
            count = small.shape[-1] - (small.shape[-1] in (2, 4))
            small[..., :count] = images.srgb_from_linear(small[..., :count])
    if stored.dtype == np.uint8:
        return images.to_uint8(small)
    return images.to_uint16(small) if stored.dtype == np.uint16 else small


@dataclass(frozen=True)
class Job:
    """One image to write at another size; the suffix of `target` selects the format."""

    source: Path
    target: Path
    width: int
    height: int
    colours: bool = True
    """As of `shrunk`."""

    def run(self) -> None:
        """Write the image with its metadata. Raises DatasetError where `target` exists, or `source` is missing or damaged."""
        if self.target.exists():
            raise DatasetError("two views would share a file", where=self.target, remedy="give each view its own name")
        small = shrunk(self.source, self.width, self.height, colours=self.colours)
        images.write(self.target, small, metadata=images.metadata(self.source))


def run(jobs: Iterable[Job], *, workers: int = 2) -> None:
    """Run all jobs, `workers` at a time. Raises as `Job.run` does, at the first that fails."""
    for _ in streamed(Job.run, jobs, workers=workers):
        pass


def streamed(work: Callable[[Item], Result], items: Iterable[Item], *, workers: int = 2) -> Iterator[Result]:
    """Results of `work` in the order of `items`, computed by `workers` threads that never run far ahead.

    Threads suffice: decoding and averaging release Python's lock.
    """
    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) > workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
