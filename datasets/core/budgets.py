"""Room for what a command is about to do: limits that environment variables raise, free memory, free disk.

The disk is asked before a long task starts, so that a full one does not end it halfway.
"""

import os
import shutil
import sys
from pathlib import Path

from koala3d.datasets.core.errors import KoalaError, UsageError


def budget(name: str, default: int) -> int:
    """The positive number in the environment variable `name`; `default` where it is not set.

    Raises UsageError: the variable holds something else.
    """
    text = os.environ.get(name, "")
    if text and not (text.isdecimal() and int(text) > 0):
        raise UsageError("is not a positive number", where=f"environment variable {name}", why=f"{text[:20]!r}")
    return int(text) if text else default


def free_memory() -> int:
    """Memory that programs can take without swapping [bytes]; unlimited where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration):
        return sys.maxsize


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
