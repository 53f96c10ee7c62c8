"""Limits that a person may raise, by environment variables."""

import os

from datasets.core.errors import UsageError


def budget(name: str, default: int) -> int:
    """The positive number in the environment variable `name`; `default` where it is not set.

    Raises:
        UsageError: the variable holds something else.
    """
    text = os.environ.get(name, "")
    if text and not (text.isdecimal() and int(text) > 0):
        raise UsageError("is not a positive number", where=f"environment variable {name}", why=f"{text[:20]!r}")
    return int(text) if text else default
