"""Locks between processes: who holds one is named, and a killed process holds none."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from koala3d.datasets.core import locks
from koala3d.datasets.core.errors import UsageError

HOLDER = """
import sys
from pathlib import Path
from koala3d.datasets.core import locks
with locks.beside(Path(sys.argv[1]), "recording"):
    print("held", flush=True)
    sys.stdin.readline()
"""


def holder(folder: Path) -> "subprocess.Popen[str]":
    """Another process that holds the lock of a folder until a line is written to it."""
    words = [sys.executable, "-c", HOLDER, str(folder)]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


def test_the_holder_is_named_and_leaves_nothing_behind(tmp_path: Path) -> None:
    other = holder(tmp_path / "session")
    with pytest.raises(UsageError, match=rf"recording is in use \(by .* process {other.pid}.*\); wait until it has finished"):
        with locks.beside(tmp_path / "session", "recording"):
            pass
    other.communicate("\n")
    with locks.beside(tmp_path / "session", "recording"):
        assert (tmp_path / ".session.lock").exists()
    assert list(tmp_path.iterdir()) == []


def test_a_killed_process_holds_no_lock(tmp_path: Path) -> None:
    other = holder(tmp_path / "session")
    os.kill(other.pid, signal.SIGKILL)
    other.wait()
    assert (tmp_path / ".session.lock").exists(), "the premise: the file is still there"
    with locks.beside(tmp_path / "session", "recording"):
        pass
    other.stdin.close()  # type: ignore[union-attr]
    other.stdout.close()  # type: ignore[union-attr]


def test_a_device_is_locked_by_its_name_on_the_whole_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locks.tempfile, "gettempdir", lambda: str(tmp_path))
    with locks.device("arm-192.168.1.10", "arm"), locks.device("arm-192.168.1.11", "arm"):
        assert sorted(path.name for path in tmp_path.iterdir()) == ["koala-arm-192.168.1.10.lock", "koala-arm-192.168.1.11.lock"]
        with pytest.raises(UsageError, match="arm is in use"), locks.device("arm-192.168.1.10", "arm"):
            pass
