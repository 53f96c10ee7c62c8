"""Jobs one after the other, each in a process of its own: its memory can be measured then, and a crash costs one job only."""

import os
import platform
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

from koala3d.datasets.core.console import hint
from koala3d.datasets.core.files import make_folder
from koala3d.reconstruct.experiments.job_log import last_line, output_in
from koala3d.reconstruct.experiments.waiting import LOOK_S, Batches, W, Waiting, Work, end_with


def run_all(batches: Batches[W]) -> Iterator[tuple[W, str | None]]:
    """Run jobs on this machine, what is nearest to its end first; a `waiting.Runner`."""
    waiting = Waiting(batches)
    while True:
        waiting.look()
        if waiting:
            job = min(waiting, key=lambda one: one.left_s)
            waiting.remove(job)
            yield job, None
            yield job, _run(job)
        elif waiting.open:
            time.sleep(LOOK_S)
        else:
            return


def _run(job: Work) -> str:
    """Run a job in a process; its error or ""."""
    prepare(job)
    with ProcessPoolExecutor(1, get_context("spawn"), initializer=end_with, initargs=(os.getpid(),)) as process:
        try:
            return process.submit(attempt, job).result()
        except BrokenProcessPool:
            return f"its process died; {job.log} ends with: {last_line(job.log.read_text(errors='replace'))}"


def prepare(job: Work) -> None:
    """Make the log that `attempt` writes to."""
    make_folder(job.log.parent)
    job.log.touch()


def attempt(job: Work) -> str:
    """Run a job in this process, its output going to its log; the error, or ""."""
    with output_in(job.log):
        hint(f"process {os.getpid()} on {platform.node()}")
        try:
            return job.attempt()
        except Exception as error:  # a bug; other jobs go on
            traceback.print_exc()
            return f"unexpected {type(error).__name__}: {' '.join(str(error).split())}; {job.log} has its traceback"
