"""What a process does while nobody looks: files that it opens, programs that it starts, memory that it takes (Linux)."""

import ctypes
import ctypes.util
import os
import struct
import sys
from pathlib import Path

WATCHED = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "pickle.find_class", "ctypes.dlopen")
"""Audit events of what reading a file must not lead to."""


class Watch:
    """Tells of every file below a folder that anybody opens, C++ libraries included (inotify), and of programs started."""

    def __init__(self, folder: Path) -> None:
        self.library = ctypes.CDLL(ctypes.util.find_library("c"), use_errno=True)
        self.descriptor = self.library.inotify_init1(os.O_NONBLOCK)
        self.folder = folder
        self.events: list[str] = []
        sys.addaudithook(lambda event, arguments: self.events.append(event) if event in WATCHED else None)
        self.refresh()

    def refresh(self) -> None:
        """Watch all folders below, also new ones; what happened so far is forgotten."""
        for path in (self.folder, *(p for p in self.folder.rglob("*") if p.is_dir())):
            self.library.inotify_add_watch(self.descriptor, os.fsencode(path), 0x20)  # IN_OPEN
        self.opened()
        self.events.clear()

    def opened(self) -> list[str]:
        """Names of files that were opened since the last call; listing a folder is no opening of a file."""
        names = []
        try:
            data = os.read(self.descriptor, 2**20)
        except BlockingIOError:
            return names
        at = 0
        while at < len(data):
            _, mask, _, length = struct.unpack_from("iIII", data, at)
            name = data[at + 16 : at + 16 + length].rstrip(b"\0").decode()
            at += 16 + length
            if name and not mask & 0x40000000:  # IN_ISDIR
                names.append(name)
        return names


def peak_bytes() -> int:
    """Most resident memory since `forget_peak`."""
    return next(
        int(line.split()[1]) * 1024 for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")
    )


def forget_peak() -> int:
    """Start anew; returns the memory in use."""
    Path("/proc/self/clear_refs").write_text("5")
    return peak_bytes()
