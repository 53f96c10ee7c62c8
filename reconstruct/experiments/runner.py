"""Jobs one after the other, each in a process of its own: its memory can be measured then, and a crash costs one job only."""

import os
import platform
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

from koala3d.datasets.core.console import hint
from koala3d.datasets.core.files import make_folder
from koala3d.reconstruct.backend import cache_compilations
from koala3d.reconstruct.experiments.job_log import last_line, output_in
from koala3d.reconstruct.experiments.jobs import Job


def run_all(jobs: Sequence[Job]) -> Iterator[tuple[Job, str]]:
    """Run jobs on this machine. Yields: each job when it has ended, with its error or ""."""
    for job in jobs:
        prepare(job)
        with ProcessPoolExecutor(1, get_context("spawn")) as process:
            try:
                problem = process.submit(attempt, job).result()
            except BrokenProcessPool:
                problem = f"its process died; {job.log} ends with: {last_line(job.log.read_text(errors='replace'))}"
        yield job, problem


def prepare(job: Job) -> None:
    """Make the log that `attempt` writes to."""
    make_folder(job.path.parent)
    job.log.touch()


def attempt(job: Job) -> str:
    """Run a job in this process, its output going to its log; the error, or ""."""
    with output_in(job.log):
        hint(f"process {os.getpid()} on {platform.node()}")
        try:
            cache_compilations()
            return job.attempt()
        except Exception as error:  # a bug; other jobs go on
            traceback.print_exc()
            return f"unexpected {type(error).__name__}: {' '.join(str(error).split())}; {job.log} has its traceback"
