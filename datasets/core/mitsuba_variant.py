"""Chooses the variant of Mitsuba: the vectorised one if it works, otherwise the scalar one, which always works.

The vectorised variant takes a third of the time but needs LLVM as a shared library, and some versions of LLVM crash the process
on some processors. Child processes therefore try the libraries of this machine, newest first. Version 19 and newer are known to
work. `DRJIT_LIBLLVM_PATH` sets the path of the library, `KOALA_RENDERER` the variant.
"""

import logging
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

FAST, SURE = "llvm_ad_rgb", "scalar_rgb"
LIBRARY = "DRJIT_LIBLLVM_PATH"
"""Environment variable from which Dr.Jit, Mitsuba's compiler, takes the path of LLVM."""
OLDEST = 16
"""Version of LLVM: 14 and 15 crash on processors with AVX-512 BF16."""
FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/lib/llvm-*/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
)
"""Where packages of operating systems put libraries."""
TRIALS, TRIAL_S = 3, 60.0
"""Libraries that are tried at most, and the time limit of each trial."""
_log = logging.getLogger(__name__)


@cache
def variant(trial: str) -> str:
    """The fastest variant of Mitsuba that passes a trial; warns if that is the slow one.

    Sets `DRJIT_LIBLLVM_PATH` to the library that passed; call this before Mitsuba is imported, which loads the library at once.

    Args:
        trial: module that a child process runs; it takes the variant's name and exits with 0 if pictures come out well.
    """
    asked = os.environ.get("KOALA_RENDERER", "")
    if asked in (FAST, SURE):
        if asked == FAST and not os.environ.get(LIBRARY) and (found := libraries()):
            os.environ[LIBRARY] = str(found[0])
        return asked
    for library in _candidates():
        environment = os.environ | ({LIBRARY: library} if library else {})
        if _passes([sys.executable, "-m", trial, FAST], environment):
            os.environ.update(environment)
            return FAST
    _log.warning("pictures are rendered without LLVM, which takes three times as long: install libllvm19, see docs/capture.md")
    return SURE


def _candidates() -> Iterator[str]:
    """Paths to try; an empty one leaves the search to Dr.Jit."""
    if set_by_user := os.environ.get(LIBRARY):
        yield set_by_user
        return
    found = libraries()[:TRIALS]
    yield from map(str, found or [""])


def _passes(command: list[str], environment: dict[str, str]) -> bool:
    try:
        done = subprocess.run(command, capture_output=True, timeout=TRIAL_S, check=False, env=environment)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def libraries(folders: tuple[str, ...] | None = None) -> list[Path]:
    """Shared libraries of LLVM that are new enough, newest first: of the system, of this environment, of Rust's toolchains.

    Args:
        folders: patterns of folders to look in; None: the usual ones.
    """
    rust = os.environ.get("RUSTUP_HOME") or str(Path.home() / ".rustup")
    places = folders or (*FOLDERS, f"{sys.prefix}/lib", f"{sys.base_prefix}/lib", f"{rust}/toolchains/*/lib")
    found: dict[Path, tuple[int, ...]] = {}
    for place in places:
        for path in Path("/").glob(f"{place.lstrip('/')}/libLLVM*"):
            number = _version(path)
            if number and number[0] >= OLDEST and path.stat().st_size > 2**20:  # Rust's folders hold linker scripts, too
                found.setdefault(path.resolve(), number)
    return sorted(found, key=lambda path: (found[path], path), reverse=True)


def _version(path: Path) -> tuple[int, ...] | None:
    """Of a library, by its name or by that of its folder: libLLVM-19.so.1, libLLVM.so.22.1-rust, llvm-19/lib/libLLVM.so."""
    match = re.search(r"^libLLVM(?:-|\.so\.)(\d+)(?:\.(\d+))?", path.name)
    if match is None and path.name in ("libLLVM.so", "libLLVM.dylib"):
        match = re.search(r"llvm[@-](\d+)(?:\.(\d+))?", str(path.resolve().parent))
    return tuple(int(number or 0) for number in match.groups()) if match else None
