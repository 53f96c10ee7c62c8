"""Files of a scene in a new place: hard links where possible, else copies; and smaller copies of its images."""

import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from pathlib import Path

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import downscale, images
from koala3d.datasets.recording import TRUTH
from koala3d.datasets.scene import LOSSY, Scene, View

Extra = Mapping[str, Path] | None
"""Further files to include in a scene, by relative name."""


def file_name(view: View) -> str:
    """A view's name as a file name."""
    return view.name.replace("/", "_")


def link(source: Path, folder: Path, name: str) -> Path:
    """Make `name` below `folder` the same file as `source`: a hard link, or a copy where the disks differ.

    Raises:
        DatasetError: `source` is no regular file, or truth behind a link; `name` exists already or leaves the folder.
    """
    target = new_file(folder, name)
    if not source.is_file():
        raise DatasetError("file is missing", where=source, why=f"{name} is made of it")
    below = source.parts[:-1][::-1].index(TRUTH) if TRUTH in source.parts[:-1] else 0
    if TRUTH in Path(name).parts and any(path.is_symlink() for path in (source, *source.parents[:below])):
        raise DatasetError("truth behind a link is not copied", where=source, remedy="replace the link by what it refers to")
    try:
        os.link(Path(source).resolve(), target)
    except OSError:
        _copy(source, target)
    return target


def new_file(folder: Path, name: str) -> Path:
    """Path of a new file below `folder`. Raises DatasetError where it exists or leaves the folder."""
    path = files.target(folder, name)
    if path.exists():
        raise DatasetError("two views would share a file", where=path, remedy="give each view its own name")
    return path


def link_all(extra: Extra, folder: Path) -> None:
    """`link` every file of `extra` below `folder`."""
    for name, source in (extra or {}).items():
        link(source, folder, name)


def _copy(source: Path, target: Path) -> None:
    """Copy a file; the error of a full disk names the target, where `shutil` names the source."""
    try:
        shutil.copyfile(source, target)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise OSError(error.errno, error.strerror, str(target)) from None
        raise


@contextmanager
def plain_masks(scene: Scene) -> Iterator[Scene]:
    """The scene with masks as other programs expect them: grey, of the image's size, white on the object and without the noise of
    compression; in a temporary folder where they differ from that."""
    with tempfile.TemporaryDirectory(prefix="koala-masks-") as folder:
        views = []
        for number, view in enumerate(scene.views):
            if view.mask is not None and not _is_plain(view):
                target = Path(folder, f"{number}.png")
                images.write(target, view.read_mask())
                view = replace(view, mask=target, mask_inverted=False)
            views.append(view)
        yield scene.with_views(tuple(views))


def _is_plain(view: View) -> bool:
    mask, same_size = view.mask, (view.camera.width, view.camera.height)
    if mask is None:
        return True
    noisy = mask.suffix.lower() in LOSSY
    return not (noisy or view.mask_inverted or images.channels(mask) != 1 or images.size(mask) != same_size)


def write_smaller(views: Sequence[View], folder: Path, sizes: Sequence[int], name: Callable[[View, Path], str]) -> None:
    """For each N of `sizes`, `images_N/` and `masks_N/` below `folder` with the views' images at 1/N of their size.

    `name` gives the name of a new file from its view and its source file.
    """
    jobs = []
    for size, view in product(sizes, views):
        small = downscale.camera(view.camera, size)
        for source, home in ((view.image, "images"), (view.mask, "masks")):
            if source is not None:
                target = files.target(folder, f"{home}_{size}/{name(view, source)}")
                jobs.append(downscale.Job(source, target, small.width, small.height, home == "images"))
    downscale.run(jobs)
