import subprocess
import sys
import time

import pytest

from koala3d.capture.drivers.cameras import genicam_lock
from koala3d.capture.drivers.cameras.genicam_lock import FOLDER, release_abandoned
from tests.moments import Clock


def semaphore(folder, name, value):
    path = folder / f"sem.{name}GenICam_XML"
    path.write_bytes(value.to_bytes(4, "little") + bytes(28))
    return path


def test_only_a_lock_that_stays_locked_is_removed(tmp_path, monkeypatch):
    class Freeing(Clock):
        def sleep(self, seconds):
            super().sleep(seconds)
            semaphore(tmp_path, "c", 1)

    monkeypatch.setattr(genicam_lock, "time", Freeing())
    abandoned, free, busy = semaphore(tmp_path, "a", 0), semaphore(tmp_path, "b", 1), semaphore(tmp_path, "c", 0)
    other = tmp_path / "sem.other"
    other.write_bytes(bytes(32))
    assert release_abandoned(tmp_path) == [abandoned.name]
    assert not abandoned.exists() and free.exists() and busy.exists() and other.exists()


def test_it_does_not_wait_where_nothing_is_locked(tmp_path, monkeypatch):
    semaphore(tmp_path, "b", 1)
    monkeypatch.setattr(time, "sleep", lambda _: pytest.fail("waited"))
    assert release_abandoned(tmp_path) == [] == release_abandoned(tmp_path / "nowhere")


def test_a_real_semaphore_of_a_killed_program(tmp_path):
    """The premise: glibc keeps the value in the first four bytes. Made, taken and abandoned by another process."""
    if not FOLDER.is_dir():
        pytest.skip("no /dev/shm: this system keeps named semaphores elsewhere")
    name = f"koala{time.time_ns()}GenICam_XML"
    code = (
        "import ctypes, os, sys\nlib = ctypes.CDLL(None)\nlib.sem_open.restype = ctypes.c_void_p\n"
        f"s = lib.sem_open(b'/{name}', os.O_CREAT, 0o600, 1)\nassert lib.sem_trywait(ctypes.c_void_p(s)) == 0\n"
        "os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    assert f"sem.{name}" in release_abandoned(patience_s=0.3)
    assert not (FOLDER / f"sem.{name}").exists()
