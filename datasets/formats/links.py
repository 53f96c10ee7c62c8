"""Files of a scene in a new place: hard links where possible, else copies; and smaller copies of its images."""

import errno
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path

from datasets.core.errors import DatasetError
from datasets.imaging import downscale
from datasets.scene import View

Extra = Mapping[str, Path] | None
"""Further files to include in a scene, by relative name."""


def file_name(view: View) -> str:
    """A view's name as a file name."""
    return view.name.replace("/", "_")


def link(source: Path, target: Path) -> None:
    """Make `target` the same file as `source`: a hard link, or a copy where the disks differ. Refuses to overwrite."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.exists():
        raise DatasetError("two views would share a file", where=target, remedy="give each view its own name")
    try:
        os.link(Path(source).resolve(), target)
    except OSError:
        _copy(source, target)


def link_all(extra: Extra, folder: Path) -> None:
    """`link` every file of `extra` below `folder`."""
    for name, source in (extra or {}).items():
        link(source, folder / name)


def _copy(source: Path, target: Path) -> None:
    """Copy a file; the error of a full disk names the target, where `shutil` names the source."""
    try:
        shutil.copyfile(source, target)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise OSError(error.errno, error.strerror, str(target)) from None
        raise


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
