"""What the processes that run a job write to their terminals, one after the other, in a file beside its run.

OUT/SCENE/MODEL/SETTING/seed_N.log
"""

import fcntl
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

STREAMS = (1, 2)
"""File descriptors of the standard output and of errors."""


@contextmanager
def output_in(log: Path) -> Iterator[None]:
    """All output of this process, the last words of a crash included, goes to the end of an existing file.

    Waits until no other process writes there: a worker on a node that a cluster takes for lost may still run.
    """
    file = os.open(log, os.O_WRONLY | os.O_APPEND)
    with suppress(OSError):  # some file systems have no locks
        fcntl.lockf(file, fcntl.LOCK_EX)
    before = [os.dup(stream) for stream in STREAMS]
    for stream in STREAMS:
        os.dup2(file, stream)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for stream, kept in zip(STREAMS, before, strict=True):
            os.dup2(kept, stream)
            os.close(kept)
        os.close(file)


def last_line(text: str) -> str:
    """The last line that is not empty, or "nothing"."""
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "nothing")
