"""What a process does beside its task: files that it opens or writes, programs that it starts, memory that it takes (Linux)."""

import ctypes
import ctypes.util
import os
import struct
import sys
from pathlib import Path

WATCHED = (
    "subprocess.Popen",
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.fork",
    "pickle.find_class",
    "ctypes.dlopen",
    "socket.connect",
    "socket.bind",
    "webbrowser.open",
)
"""Audit events of what reading a file must not lead to."""
FOREIGN = "/etc/passwd"
"""A file that corrupted inputs name; whoever opens it was led astray."""
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
IN_OPEN, IN_MODIFY, IN_MOVED_TO, IN_CREATE, IN_ISDIR = 0x20, 0x2, 0x80, 0x100, 0x40000000


class Watch:
    """Sees every file that is opened below a folder outside (by inotify, C++ libraries included), every file that appears
    where it must not, every file of elsewhere that Python writes, and programs that are started.

    Args:
        work: everything happens here; what appears in it beside the allowed folders is strange.
        folder: outside of all inputs, inside `work`; nobody may open anything in it.
    """

    def __init__(self, work: Path, folder: Path) -> None:
        self.library = ctypes.CDLL(ctypes.util.find_library("c"), use_errno=True)
        self.descriptor = self.library.inotify_init1(os.O_NONBLOCK)
        self.work, self.folder = work, folder
        self.events: list[str] = []
        self.active = False
        sys.addaudithook(self._audit)
        self.refresh()

    def _audit(self, event: str, arguments: tuple) -> None:
        if not self.active:
            return
        if event in WATCHED:
            self.events.append(event)
        elif event == "open" and isinstance(arguments[0], str | bytes):
            path, _, flags = arguments
            path = os.path.abspath(os.fsdecode(path))
            if path == FOREIGN or (flags & WRITING and not path.startswith((str(self.work.parent), "/dev/", "/proc/self/"))):
                self.events.append(f"opened {path}")

    def refresh(self) -> None:
        """Watch all folders outside, new ones too; what happened so far is forgotten."""
        for path in (self.folder, *(p for p in self.folder.rglob("*") if p.is_dir())):
            self.library.inotify_add_watch(self.descriptor, os.fsencode(path), IN_OPEN | IN_MODIFY | IN_MOVED_TO | IN_CREATE)
        self._touched()
        self.events.clear()
        self.before = self._listing(())
        self.active = True

    def strange(self, *, allowed: tuple[Path, ...]) -> list[str]:
        """What happened since `refresh` that must not; files that appeared are removed again."""
        self.active = False
        touched = self._touched()
        appeared = sorted(self._listing(allowed) - self.before)
        for path in reversed(appeared):
            (path.rmdir if path.is_dir() and not path.is_symlink() else path.unlink)()
        return [
            *self.events,
            *(f"touched {name}" for name in touched),
            *(f"wrote {path.relative_to(self.work)}" for path in appeared),
        ]

    def _listing(self, allowed: tuple[Path, ...]) -> set[Path]:
        """Everything in `work` but what is in the allowed folders."""
        found, waiting = set(), [self.work]
        while waiting:
            for entry in os.scandir(waiting.pop()):
                path = Path(entry.path)
                if path in allowed or path.name == "output":
                    waiting += [path] if path.name == "output" else []
                    continue
                found.add(path)
                if entry.is_dir(follow_symlinks=False) and path != self.work / "input":
                    waiting.append(path)
        return found

    def _touched(self) -> list[str]:
        """Names of files outside that were opened or written since the last call; listing a folder is none of it."""
        names = []
        try:
            data = os.read(self.descriptor, 2**20)
        except BlockingIOError:
            return names
        at = 0
        while at < len(data):
            _, mask, _, length = struct.unpack_from("iIII", data, at)
            name = data[at + 16 : at + 16 + length].rstrip(b"\0").decode(errors="replace")
            at += 16 + length
            if name and not (mask & IN_ISDIR and mask & IN_OPEN):
                names.append(name)
        return names


def peak_bytes() -> int:
    """Most resident memory since `forget_peak`."""
    status = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM"))


def forget_peak() -> int:
    """Start anew; returns the memory in use."""
    Path("/proc/self/clear_refs").write_text("5")
    return peak_bytes()
