"""The system calls by which a program changes a folder, recorded with strace (Linux; Debian package strace).

recorded(["python", "program.py"], folder)  ->  [Call("mkdir", ...), Call("write", ...), ...] in the order of their completion
"""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

OPENS = ("open", "openat", "creat")
WRITES = (
    "write",
    "pwrite64",
    "writev",
    "pwritev",
    "pwritev2",
    "sendfile",
    "copy_file_range",
    "ftruncate",
    "truncate",
    "fallocate",
)
NAMES = (
    "rename",
    "renameat",
    "renameat2",
    "unlink",
    "unlinkat",
    "rmdir",
    "mkdir",
    "mkdirat",
    "link",
    "linkat",
    "symlink",
    "symlinkat",
)
OTHERS = ("lseek", "close", "dup", "dup2", "dup3", "fcntl", "fsync", "fdatasync", "sync", "syncfs", "mmap", "ioctl")
_LINE = re.compile(r"(\d+)\s+(?:<\.\.\. (\w+) resumed>)?(.*)")
_END = re.compile(r"\)\s*= (-?\d+|0x[0-9a-f]+|\?)(.*)$")


@dataclass(frozen=True)
class Call:
    """One system call that succeeded."""

    name: str
    arguments: tuple[str, ...]
    result: int
    returned: str
    """What strace says after the result: the path of a descriptor, in angle brackets."""


def available() -> str:
    """Why nothing can be recorded here; empty where it can."""
    if shutil.which("strace") is None:
        return "strace is absent: apt install strace"
    tried = subprocess.run(["strace", "-f", "-y", "--seccomp-bpf", "true"], capture_output=True, text=True, check=False)
    return "" if tried.returncode == 0 else f"strace may not trace here: {tried.stderr.strip()[-100:]}"


def recorded(command: Sequence[str], environment: dict[str, str]) -> list[Call]:
    """Run a command and return its calls that change files, those of all its threads and children.

    Raises:
        RuntimeError: the command failed.
    """
    with tempfile.NamedTemporaryFile("r", suffix=".strace") as log:
        names = ",".join((*OPENS, *WRITES, *NAMES, *OTHERS))
        words = [
            "strace",
            "-f",
            "-y",
            "-xx",
            "-s",
            "100000000",
            "--seccomp-bpf",
            "-o",
            log.name,
            "-e",
            f"trace={names}",
            *command,
        ]
        done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)} failed: {done.stderr[-2000:]}")
        return parsed(log.read().splitlines())


def parsed(lines: Sequence[str]) -> list[Call]:
    """Calls from strace's lines; halves of a call that others interrupted are put together."""
    begun: dict[str, str] = {}
    calls = []
    for line in lines:
        found = _LINE.match(line)
        if found is None:
            continue
        thread, resumed, text = found[1], found[2], found[3]
        if text.endswith("<unfinished ...>"):
            begun[thread] = text.removesuffix("<unfinished ...>").rstrip()
            continue
        if resumed:
            text = begun.pop(thread, f"{resumed}(") + text.lstrip()
        end = _END.search(text)
        if end is None or end[1] == "?" or end[1].startswith("-") or "(" not in text:
            continue
        name, _, inner = text[: end.start()].partition("(")
        calls.append(Call(name.strip(), _split(inner), int(end[1], 0), end[2].strip()))
    return calls


def _split(text: str) -> tuple[str, ...]:
    """Arguments at the commas outside of brackets, angle brackets and quotes. Texts are in hexadecimal, so hold none of these."""
    parts, depth, start = [], 0, 0
    for place, letter in enumerate(text):
        if letter in "[{":
            depth += 1
        elif letter in "]}":
            depth -= 1
        elif letter == "," and depth == 0:
            parts.append(text[start:place].strip())
            start = place + 1
    return (*parts, text[start:].strip())


def data_of(argument: str) -> bytes:
    """Bytes of a quoted argument, or of all buffers of a vector."""
    if argument.endswith("..."):
        raise RuntimeError("strace cut off what was written")
    return b"".join(bytes.fromhex(part.replace("\\x", "")) for part in re.findall(r'"([^"]*)"', argument))


def path_of(argument: str) -> Path | None:
    """Path of a descriptor ("3<...>") or of a quoted name; None where it has none."""
    found = re.search(r"<([^>]*)>", argument) or re.search(r'"([^"]*)"', argument)
    if found is None:
        return None
    text = re.sub(r"\\x([0-9a-f]{2})", lambda one: chr(int(one[1], 16)), found[1])
    return Path(text.encode("latin-1").decode(errors="surrogateescape"))


def descriptor_of(argument: str) -> int:
    """Number of a descriptor ("3<...>")."""
    return int(argument.partition("<")[0])
