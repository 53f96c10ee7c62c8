"""The log of a job is written at the level of file descriptors, by one process at a time."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from koala3d.reconstruct.experiments.job_log import last_line, output_in
from tests.moments import PATIENCE_S, until

HOLDER = """
import fcntl, sys
file = open(sys.argv[1], "a")
fcntl.lockf(file, fcntl.LOCK_EX)
print("held", flush=True)
sys.stdin.readline()
file.write("of the first\\n")
"""


def waits_for_a_lock() -> bool:
    """Whether a thread of this process waits for the lock of a file."""
    return any("->" in line and f" {os.getpid()} " in line for line in Path("/proc/locks").read_text().splitlines())


@pytest.mark.skipif(sys.platform != "linux", reason="who waits for a lock is looked up in /proc")
def test_a_second_process_waits_until_the_first_is_gone(tmp_path: Path) -> None:
    log = tmp_path / "seed_0.log"
    log.touch()

    def second() -> None:
        with output_in(log):
            os.write(1, b"of the second\n")
            os.write(2, b"its last word\n")

    with (
        subprocess.Popen([sys.executable, "-c", HOLDER, log], stdin=-1, stdout=-1, text=True) as holder,
        ThreadPoolExecutor(1) as thread,
    ):
        assert holder.stdout is not None and holder.stdout.readline() == "held\n"
        done = thread.submit(second)
        until(lambda: waits_for_a_lock() or done.done(), "a second process that waits")
        holder.communicate("\n")
        done.result(PATIENCE_S)
    assert log.read_text() == "of the first\nof the second\nits last word\n"
    assert os.readlink("/proc/self/fd/1") != str(log) != os.readlink("/proc/self/fd/2")


def test_the_last_line_is_not_empty() -> None:
    assert last_line("first\n  second \n\n") == "second" and last_line("\n") == "nothing"
