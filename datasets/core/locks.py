"""Locks that one process holds at a time, with its name in them: of a recording, an arm or a camera.

The operating system releases a lock when its process ends, however it ends. Locks hold on local disks, and on NFS between all of
its machines.
"""

import errno
import getpass
import os
import re
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError

if sys.platform == "win32":
    import msvcrt

    def _lock(handle: int) -> None:
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
else:
    import fcntl

    def _lock(handle: int) -> None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


TAKEN = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
MOST_BYTES = 500


@contextmanager
def held(path: Path, what: str) -> Iterator[None]:
    """Hold the lock in the file `path` while the block runs; the file is there only meanwhile.

    Raises:
        UsageError: another process, or another block of this one, holds it; the message names it.
    """
    handle = _opened(path, what)
    try:
        os.write(handle, f"{_owner()}\n".encode())
        yield
    finally:
        with suppress(OSError):
            path.unlink()  # while it is locked: whoever waits for this file finds that it is not the one in the folder
        os.close(handle)


@contextmanager
def beside(folder: Path, what: str) -> Iterator[None]:
    """Hold the lock of a folder, which need not exist yet, in a hidden file beside it. Raises as `held` does."""
    whole = Path(folder).absolute()
    files.make_folder(whole.parent)
    with held(whole.with_name(f".{whole.name}.lock"), what):
        yield


@contextmanager
def device(name: str, what: str) -> Iterator[None]:
    """Hold the lock of a device on this machine, by its address or serial number. Raises as `held` does."""
    with held(Path(tempfile.gettempdir()) / f"koala-{re.sub(r'[^A-Za-z0-9.]+', '-', name)}.lock", what):
        yield


def _opened(path: Path, what: str) -> int:
    """An open, locked and empty file."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        try:
            _lock(handle)
            if path.exists() and os.stat(path).st_ino == os.fstat(handle).st_ino:
                os.ftruncate(handle, 0)
                return handle
        except OSError as error:
            owner = os.read(handle, MOST_BYTES).decode("utf-8", "replace").strip()
            os.close(handle)
            if error.errno not in TAKEN:
                raise
            remedy = "wait until it has finished, or stop it"
            raise UsageError(f"{what} is in use", where=path, why=owner or "by another process", remedy=remedy) from None
        os.close(handle)  # it was removed by the one who held it


def _owner() -> str:
    command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:200]
    with suppress(OSError, KeyError):
        since = time.strftime("%H:%M:%S")
        return f"by {getpass.getuser()} on {socket.gethostname()}, process {os.getpid()}, since {since}: {command}"
    return f"by process {os.getpid()} on {socket.gethostname()}: {command}"
