"""Room on the disk: asked before a long task starts, so that a full disk does not end it halfway."""

import shutil
from pathlib import Path

from koala3d.datasets.core.errors import KoalaError


def require_room(folder: Path, size: float, what: str) -> None:
    """Raise KoalaError where the disk of `folder`, which need not exist yet, has less than `size` bytes free for `what`."""
    folder = Path(folder)
    absolute = folder.absolute()
    free = shutil.disk_usage(next(path for path in (absolute, *absolute.parents) if path.exists())).free
    if size > free:
        why, remedy = f"up to {readable(size)} needed, {readable(free)} free", "free some space, or write to another disk"
        raise KoalaError(f"the disk has no room for {what}", where=folder, why=why, remedy=remedy)


def readable(size: float) -> str:
    """A number of bytes for a person: "1.5 GB"."""
    unit, name = next(((unit, name) for unit, name in ((1e9, "GB"), (1e6, "MB")) if size >= unit), (1e3, "kB"))
    return f"{size / unit:.1f} {name}"
