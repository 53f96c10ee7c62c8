"""Files of a scene in a new place, and smaller copies of its images.

A file that Koala made becomes a hard link in another folder of Koala's. Everything else is copied, so that nobody who edits a
picture changes another: what others made, and what is written for others.
"""

import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import product
from pathlib import Path

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats.finding.pictures import PICTURES
from koala3d.datasets.imaging import downscale, images, orientation
from koala3d.datasets.recording import TRUTH
from koala3d.datasets.scene import LOSSY, Scene, View

Extra = Mapping[str, Path] | None
"""Further files to include in a scene, by relative name."""


MARKS = ("cameras.json", "manifest.json", "request.json")
"""Files of which one lies at the top of every folder that Koala made."""
OWN, HEAD = b'"koala-', 100
"""What begins the name of their format, and the bytes in which it stands."""
MOST_FOLDERS = 4
"""Folders from a file of a scene to its top, at most."""
CLONE = 0x40049409
"""Linux' request FICLONE (ioctl_ficlone(2))."""


def file_name(view: View) -> str:
    """A view's name as a file name."""
    return view.name.replace("/", "_")


def link(source: Path, folder: Path, name: str) -> Path:
    """`source` as `name` below `folder`: a hard link if Koala made it and the disk can, else a `copy`. Raises as that does."""
    target = _new_target(source, folder, name)
    if not is_own(source):
        return _copied(source, target)
    try:
        os.link(Path(source).resolve(), target)
    except OSError:
        _copied(source, target)
    return target


def copy(source: Path, folder: Path, name: str) -> Path:
    """A copy of `source` as `name` below `folder`. Its pixels stay as they are stored; an orientation tag is left out.

    Raises:
        DatasetError: `source` is no regular file, or truth behind a link; `name` exists already or leaves the folder.
    """
    return _copied(source, _new_target(source, folder, name))


def is_own(path: Path) -> bool:
    """Whether a file lies in a scene or a recording of Koala's, or in the work folder of one."""
    for folder in Path(path).absolute().parents[:MOST_FOLDERS]:
        for name in MARKS:
            with suppress(OSError), open(folder / name, "rb") as file:
                if OWN in file.read(HEAD):
                    return True
    return False


def _new_target(source: Path, folder: Path, name: str) -> Path:
    target = new_file(folder, name)
    if not source.is_file():
        raise DatasetError("file is missing", where=source, why=f"{name} is made of it")
    below = source.parts[:-1][::-1].index(TRUTH) if TRUTH in source.parts[:-1] else 0
    if TRUTH in Path(name).parts and any(path.is_symlink() for path in (source, *source.parents[:below])):
        raise DatasetError("truth behind a link is not copied", where=source, remedy="replace the link by what it refers to")
    return target


def new_file(folder: Path, name: str) -> Path:
    """Path of a new file below `folder`. Raises DatasetError where it exists or leaves the folder."""
    path = files.target(folder, name)
    if path.exists():
        raise DatasetError("two views would share a file", where=path, remedy="give each view its own name")
    return path


def copy_all(extra: Extra, folder: Path) -> None:
    """`copy` every file of `extra` below `folder`."""
    for name, source in (extra or {}).items():
        copy(source, folder, name)


def _copied(source: Path, target: Path) -> Path:
    """`target`, copied; file systems that can, share the blocks. The error of a full disk names the target, not the source."""
    if source.suffix.lower() in PICTURES and images.orientation(source) != 1:
        orientation.write_untagged(source, target)
        return target
    try:
        with open(source, "rb") as old, open(target, "xb") as new:
            if not _shares_blocks(old.fileno(), new.fileno()):
                shutil.copyfileobj(old, new, length=2**20)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise OSError(error.errno, error.strerror, str(target)) from None
        raise
    return target


def _shares_blocks(source: int, target: int) -> bool:
    """Let a new file share the blocks of another until one of them changes; False if the file system cannot."""
    try:
        import fcntl

        fcntl.ioctl(target, CLONE, source)
    except (ImportError, OSError):
        return False
    return True


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
