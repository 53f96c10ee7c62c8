"""Frees what a killed program leaves behind in the vendor's library, and every later one would wait for without end.

pylon guards its cache of camera descriptions with named semaphores (/dev/shm/sem.*GenICam_XML) that it holds for
milliseconds while a camera is looked for or opened. A process that is killed in just these leaves one at zero for good:
from then on `import pypylon` polls it for ever, in every program on the computer. Seen with pylon 26.9 and kill -9.
"""

import logging
import time
from pathlib import Path

log = logging.getLogger(__name__)
FOLDER, PATTERN = Path("/dev/shm"), "sem.*GenICam_XML"
PATIENCE_S, PERIOD_S = 2.0, 0.02


def release_abandoned(folder: Path = FOLDER, *, patience_s: float = PATIENCE_S) -> list[str]:
    """Remove each semaphore that stays at zero for `patience_s`; returns their names. Takes no time where none is at zero.

    The library makes a new one at its next use. Somebody who does hold the old one, in spite of the time, goes on with it.
    """
    held = {path for path in folder.glob(PATTERN) if _value(path) == 0}
    deadline = time.monotonic() + patience_s
    while held and time.monotonic() < deadline:
        time.sleep(PERIOD_S)
        held = {path for path in held if _value(path) == 0}
    for path in held:
        try:
            path.unlink(missing_ok=True)
        except PermissionError:
            log.warning("%s is held by a program that was killed, and belongs to somebody else: pylon will wait for it", path)
        else:
            log.warning("%s was left by a program that was killed: removed, pylon would have waited for it", path)
    return sorted(path.name for path in held)


def _value(path: Path) -> int:
    """Value of a named semaphore of glibc, from its file; -1 where it is gone or cannot be read."""
    try:
        return int.from_bytes(path.read_bytes()[:4], "little")
    except OSError:
        return -1
