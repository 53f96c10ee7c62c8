"""Removes locks that a killed program left in the vendor's library, for which every later program would wait forever.

pylon protects its cache of camera descriptions with named semaphores (/dev/shm/sem.*GenICam_XML). It holds them for
milliseconds while it enumerates or opens cameras. A process that is killed at that moment leaves a semaphore at zero, and
from then on `import pypylon` polls it forever in every program on the computer. Seen with pylon 26.9 and kill -9.
"""

import logging
import time
from pathlib import Path

log = logging.getLogger(__name__)
FOLDER, PATTERN = Path("/dev/shm"), "sem.*GenICam_XML"
PATIENCE_S, PERIOD_S = 2.0, 0.02


def release_abandoned(folder: Path = FOLDER, *, patience_s: float = PATIENCE_S) -> list[str]:
    """Remove each semaphore that stays at zero for `patience_s`; returns their names. Takes no time if none is at zero.

    The library creates a new one at its next use. A program that still holds the old one continues with it.
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
            log.warning("%s was left by a killed program and belongs to another user: pylon will wait for it", path)
        else:
            log.warning("%s was left by a killed program and has been removed", path)
    return sorted(path.name for path in held)


def _value(path: Path) -> int:
    """Value of a named glibc semaphore, read from its file; -1 if it does not exist or cannot be read."""
    try:
        return int.from_bytes(path.read_bytes()[:4], "little")
    except OSError:
        return -1
