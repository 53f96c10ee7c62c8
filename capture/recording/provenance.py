"""Who runs which command with which software: the first line of a session's log."""

import getpass
import hashlib
import os
import platform
import socket
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from koala3d.datasets.core import console

PACKAGES = ("koala-capture", "ur-rtde", "pypylon", "numpy", "opencv-contrib-python-headless")
"""Packages whose versions are stated, where they are installed."""
GIT_S = 5.0


def facts() -> dict[str, Any]:
    """Command line, user, host, process, versions, and what identifies the software: its commit and a hash of its sources."""
    user = ""
    with suppress(OSError, KeyError):
        user = getpass.getuser()
    return {
        "command": console.command_line(),
        "user": user,
        "host": socket.gethostname(),
        "process": os.getpid(),
        "python": platform.python_version(),
        "system": platform.platform(),
        "versions": _versions(),
        "commit": commit(_home()),
        "source_sha256": _source_hash(),
    }


def _home() -> Path:
    """The folder of the package `capture`."""
    return Path(__file__).resolve().parent.parent


def _versions() -> dict[str, str]:
    found = {}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def commit(folder: Path) -> str:
    """The git commit of a working copy, ending in "-dirty" if its files differ from it; empty where there is none.

    A folder that git does not track has none, such as a package that is installed somewhere below another project.
    """
    return _git(folder, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*") if _git(folder, "ls-files", ".") else ""


def _git(folder: Path, *words: str) -> str:
    try:
        done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, timeout=GIT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _source_hash() -> str:
    """SHA-256 over the Python files of `capture` and what it stands on, `datasets`: also without git it says which code ran."""
    digest = hashlib.sha256()
    for package in (_home(), _home().parent / "datasets"):
        for path in sorted(package.rglob("*.py")):
            digest.update(f"{path.relative_to(package.parent)}\n".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
