"""Limits that a person may raise by environment variables, and the free memory."""

import os
import sys
from pathlib import Path

from koala3d.datasets.core.errors import UsageError


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
