import logging
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from koala3d.datasets.core import mitsuba_variant
from koala3d.datasets.core.mitsuba_variant import FAST, LIBRARY, SURE, libraries, variant

TRIAL = "a.trial"


@pytest.fixture(autouse=True)
def forgotten(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No library is set, what an earlier trial has shown is not remembered, nor what this one does."""
    monkeypatch.setenv(LIBRARY, "")  # whatever a test sets is taken back after it
    monkeypatch.delenv("KOALA_RENDERER", raising=False)
    variant.cache_clear()
    yield
    variant.cache_clear()


def trial_ends(monkeypatch: pytest.MonkeyPatch, *codes: int) -> list[str]:
    """Let trials end with these codes, one after the other; returns the libraries that they are given."""
    tried: list[str] = []

    def run(command: list[str], *, env: dict[str, str], **options: object) -> subprocess.CompletedProcess[bytes]:
        tried.append(env[LIBRARY])
        return subprocess.CompletedProcess(command, returncode=codes[len(tried) - 1])

    monkeypatch.setattr(subprocess, "run", run)
    return tried


def found(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    monkeypatch.setattr(mitsuba_variant, "libraries", lambda: [Path(name) for name in names])


def test_can_be_asked_for(monkeypatch, caplog):
    monkeypatch.setenv("KOALA_RENDERER", SURE)
    assert variant(TRIAL) == SURE and not caplog.records  # who asks for it is not warned


def test_falls_back_where_all_trials_die_and_says_so(monkeypatch, caplog):
    found(monkeypatch, "/a/libLLVM.so.19", "/b/libLLVM.so.18")
    trial_ends(monkeypatch, -6, 1)
    with caplog.at_level(logging.WARNING):
        assert variant(TRIAL) == SURE
    assert "libllvm19" in caplog.text


def test_falls_back_where_the_trial_hangs(monkeypatch):
    def hang(*arguments: object, **options: object) -> None:
        raise subprocess.TimeoutExpired("trial", 60)

    monkeypatch.setattr(subprocess, "run", hang)
    assert variant(TRIAL) == SURE


def test_takes_the_first_library_that_survives(monkeypatch):
    found(monkeypatch, "/a/libLLVM.so.22", "/b/libLLVM.so.19")
    tried = trial_ends(monkeypatch, -6, 0)
    assert variant(TRIAL) == FAST
    assert tried == ["/a/libLLVM.so.22", "/b/libLLVM.so.19"] and mitsuba_variant.os.environ[LIBRARY] == "/b/libLLVM.so.19"


def test_tries_nothing_but_the_library_of_the_user(monkeypatch):
    found(monkeypatch, "/a/libLLVM.so.22")
    monkeypatch.setenv(LIBRARY, "/mine/libLLVM.so")
    tried = trial_ends(monkeypatch, 1)
    assert variant(TRIAL) == SURE and tried == ["/mine/libLLVM.so"]


def test_libraries_are_newest_first_and_none_is_too_old(tmp_path):
    names = [
        "system/libLLVM-15.so.1",
        "system/libLLVM.so.18.1",
        "rust/libLLVM.so.22.1-rust-1.95",
        "llvm-19/lib/libLLVM.so",
        "rust/libLLVM-22-rust.so",
    ]
    for name in names:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(2**21) if name != names[-1] else b"INPUT(libLLVM.so.22.1-rust-1.95)")
    folders = tuple(f"{tmp_path}/{part}" for part in ("system", "rust", "llvm-*/lib"))
    assert libraries(folders) == [tmp_path / name for name in (names[2], names[3], names[1])]
