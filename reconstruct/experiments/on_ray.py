"""Jobs as Ray tasks. If a job's worker is lost, the job goes on in another one, from its last checkpoint.

All nodes need the scenes and the sweep's folder under the same paths, and the same version of Koala.
"""

import logging
import os
import platform
import socket
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout

import ray
from ray.exceptions import NodeDiedError, OutOfMemoryError, RayError, WorkerCrashedError

from koala3d.datasets.core.console import hint
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.experiments.job_log import last_line
from koala3d.reconstruct.experiments.jobs import Job
from koala3d.reconstruct.experiments.runner import attempt, prepare

MOST_LOSSES = 3
"""A job that has lost so many workers is given up: the fault is probably its own."""
ANSWER_S = 10.0
"""Longest time in which a cluster answers."""
LOST = {WorkerCrashedError: "it crashed or was killed", OutOfMemoryError: "out of memory", NodeDiedError: "its node is gone"}
SHARED = "is --out on a disk that all nodes share?"


def run_all(jobs: Sequence[Job], address: str | None) -> Iterator[tuple[Job, str]]:
    """Run jobs on a cluster, each with a GPU if the cluster has any; without an address, on this machine.

    Yields:
        Each job when it has ended, with its error or "".

    Raises UsageError: there is no such cluster.
    """
    with _connected(address):
        gpus = 1 if ray.cluster_resources().get("GPU") else 0
        task = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=0, max_calls=1, scheduling_strategy="SPREAD")(_attempt)
        for job in jobs:
            prepare(job)
        running, losses = {task.remote(job): job for job in jobs}, Counter[Job]()
        while running:
            (ended,), _ = ray.wait(list(running))
            job = running.pop(ended)
            try:
                node, problem = ray.get(ended)
                if not problem and not job.done:
                    problem = f"ended on {node} and left no {job.result}; {SHARED}"
            except tuple(LOST) as loss:
                losses[job] += 1
                if losses[job] < MOST_LOSSES:
                    hint(f"{job.path}: lost its worker ({LOST[type(loss)]}), {losses[job]} of {MOST_LOSSES}: goes on elsewhere")
                    running[task.remote(job)] = job
                    continue
                last = last_line(job.log.read_text(errors="replace"))
                problem = f"lost its worker {MOST_LOSSES} times; {job.log} ends with: {last}"
            except RayError as error:
                why = last_line(str(getattr(error, "cause", error)))
                problem = f"Ray cannot run it ({why}); do all nodes have this version of Koala?"
            yield job, problem


@contextmanager
def _connected(address: str | None) -> Iterator[None]:
    """A connection to a cluster, which prints nothing to the standard output."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a cluster that Ray starts here does not report to its makers
    with redirect_stdout(sys.stderr):
        try:
            _require_listener(address or "")
            ray.init(address=address, log_to_driver=False, logging_level=logging.WARNING)
        except (OSError, RuntimeError, ValueError) as error:
            why, remedy = str(error).partition("\n")[0], "give the address that 'ray start --head' printed"
            raise UsageError("cannot join the Ray cluster", where=address or "", why=why, remedy=remedy) from None
        try:
            yield
        finally:
            ray.shutdown()


def _require_listener(address: str) -> None:
    """Raise OSError if nobody listens at HOST:PORT: Ray would try for minutes."""
    host, _, port = address.rpartition(":")
    if port.isdecimal():
        socket.create_connection((host.removeprefix("ray://"), int(port)), timeout=ANSWER_S).close()


def _attempt(job: Job) -> tuple[str, str]:
    """Run a job in a worker; the name of its node, and the job's error or ""."""
    node = platform.node()
    return node, attempt(job) if job.log.is_file() else f"{node} does not see {job.log}; {SHARED}"
