"""Smaller copies of a scene's images: the folders `images_N` and `masks_N`."""

from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

from datasets.imaging import downscale
from datasets.scene import View


def write_smaller(views: Sequence[View], folder: Path, sizes: Sequence[int], name: Callable[[View, Path], str]) -> None:
    """For each N of `sizes`, `images_N/` and `masks_N/` below `folder` with the views' images at 1/N of their size.

    `name` gives the name of a new file from its view and its source file.
    """
    jobs = []
    for size, view in product(sizes, views):
        small = downscale.camera(view.camera, size)
        for source, home in ((view.image, "images"), (view.mask, "masks")):
            if source is not None:
                target = folder / f"{home}_{size}" / name(view, source)
                jobs.append(downscale.Job(source, target, small.width, small.height, home == "images"))
    downscale.run(jobs)
