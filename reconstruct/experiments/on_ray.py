"""Jobs as Ray tasks. If a job's worker is lost, the job goes on in another one, from its last checkpoint.

All nodes need the scenes and the folder of the results under the same paths, and the same version of Koala.
"""

import logging
import os
import platform
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from importlib.metadata import version
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import NodeDiedError, OutOfMemoryError, RayError, WorkerCrashedError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from koala3d.datasets.core.console import hint
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.experiments.job_log import last_line
from koala3d.reconstruct.experiments.runner import attempt, prepare
from koala3d.reconstruct.experiments.waiting import LOOK_S, Batches, Needs, W, Waiting, Work

MOST_LOSSES = 3
"""A job that has lost so many workers is given up: the fault is probably its own."""
ANSWER_S = 10.0
"""Longest time in which a cluster answers."""
START_S = 120.0
"""Longest time in which a node starts a worker [s]."""
DISTRIBUTION = "koala-capture"
LOST = {WorkerCrashedError: "it crashed or was killed", OutOfMemoryError: "out of memory", NodeDiedError: "its node is gone"}
SHARED = "is --out on a disk that all nodes share?"


def run_all(batches: Batches[W], address: str | None, *, shared: Sequence[Path] = ()) -> Iterator[tuple[W, str | None]]:
    """Run jobs on a cluster, each with what it needs, those with the most work left first; a `waiting.Runner`.

    Args:
        address: of the cluster; None for this machine.
        shared: the folder to write in, and further files, which every node must see.

    Raises UsageError: there is no such cluster, or a node does not see what is shared.
    """
    waiting, running, losses = Waiting(batches), dict[Any, W](), Counter[Path]()
    with _connected(address):
        _require_shared(shared)
        while True:
            waiting.look()
            for job in sorted(waiting, key=lambda one: -one.left_s):
                if _fits(job, running.values()):
                    waiting.remove(job)
                    prepare(job)
                    running[_submitted(job)] = job
                    yield job, None
            if running:
                ended, _ = ray.wait(list(running), timeout=LOOK_S if waiting or waiting.open else None)
                for one in ended:
                    job = running.pop(one)
                    problem = _outcome(one, job, losses)
                    if problem is None:
                        waiting.append(job)
                    else:
                        yield job, problem
            elif waiting:
                job = waiting.pop(0)
                yield job, f"no node of the cluster has what it needs ({_said(job.needs)})"
            elif waiting.open:
                time.sleep(LOOK_S)
            else:
                return


def _outcome(ended: Any, job: Work, losses: Counter[Path]) -> str | None:
    """The error of a job that has ended, or "", or None if it has lost its worker and goes on elsewhere."""
    try:
        node, problem = ray.get(ended)
        if not problem and not job.done:
            problem = f"ended on {node} and left no {job.result}; {SHARED}"
        return problem
    except tuple(LOST) as loss:
        losses[job.result] += 1
        if (count := losses[job.result]) < MOST_LOSSES:
            hint(
                f"{job.result.with_suffix('')}: lost its worker ({LOST[type(loss)]}), {count} of {MOST_LOSSES}: goes on elsewhere"
            )
            return None
        return f"lost its worker {MOST_LOSSES} times; {job.log} ends with: {last_line(job.log.read_text(errors='replace'))}"
    except RayError as error:
        why = last_line(str(getattr(error, "cause", error)))
        return f"Ray cannot run it ({why}); do all nodes have this version of Koala?"


def _gpus(needs: Needs) -> float:
    """Share of a GPU that a job gets."""
    return needs.gpus if needs.gpus is not None else float(bool(ray.cluster_resources().get("GPU")))


def _wanted(needs: Needs) -> dict[str, float]:
    """What Ray counts of a job's needs, by Ray's names."""
    return {"CPU": needs.cores, "GPU": _gpus(needs), "memory": needs.memory_gb * 1e9}


def _said(needs: Needs) -> str:
    """Needs in words."""
    memory = f", {needs.memory_gb:g} GB of memory" if needs.memory_gb else ""
    return f"{needs.cores:g} cores{memory}, {_gpus(needs):g} GPUs"


def _fits(job: Work, running: Iterable[Work]) -> bool:
    """Whether a node could run it, and the cluster has so much to spare. Ray waits for a node where the rest is scattered."""
    wanted, total = _wanted(job.needs), ray.cluster_resources()
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    if not any(all(node.get(name, 0) >= amount for name, amount in wanted.items()) for node in nodes):
        return False
    used = [_wanted(other.needs) for other in running]
    return all(total.get(name, 0) - sum(one[name] for one in used) >= amount - 1e-6 for name, amount in wanted.items())


def _submitted(job: Work) -> Any:
    """The running task of a job."""
    needs, wanted = job.needs, _wanted(job.needs)
    options = {"num_cpus": needs.cores, "num_gpus": wanted["GPU"], "memory": int(wanted["memory"]) or None}
    return ray.remote(max_retries=0, max_calls=1, scheduling_strategy="SPREAD", **options)(_attempt).remote(job)


def _require_shared(shared: Sequence[Path]) -> None:
    """Raise UsageError if a node does not see this very folder, `shared[0]`, the other files, or has another version of Koala."""
    if not shared:
        return
    with tempfile.NamedTemporaryFile("w", prefix=".shared-", dir=shared[0]) as mark:  # its name is nowhere else
        paths = [mark.name, *map(str, shared)]
        tasks = {}
        for node in (node for node in ray.nodes() if node["Alive"]):
            place = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
            task = ray.remote(num_cpus=0, max_retries=0, scheduling_strategy=place)(_seen)
            tasks[task.remote(paths)] = f"node {node['NodeManagerHostname']} ({node['NodeManagerAddress']})"
        ended, silent = ray.wait(list(tasks), num_returns=len(tasks), timeout=START_S)
        for one in silent:
            raise UsageError("does not answer", where=tasks[one], why=f"waited for {START_S:g} s", remedy="look at 'ray status'")
        for one in ended:
            try:
                unseen, found = ray.get(one)
            except RayError as error:
                why = last_line(str(getattr(error, "cause", error)))
                remedy = "install this version of Koala on all nodes"
                raise UsageError("cannot run Koala", where=tasks[one], why=why, remedy=remedy) from None
            if unseen:
                place = shared[0] if unseen == mark.name else unseen
                remedy = "put it on a disk that all nodes see under the same path"
                raise UsageError(f"does not see {place}", where=tasks[one], remedy=remedy)
            if found != version(DISTRIBUTION):
                why = f"{found} there, {version(DISTRIBUTION)} here"
                raise UsageError(
                    "has another version of Koala", where=tasks[one], why=why, remedy="install the same on all nodes"
                )


def _seen(paths: Sequence[str]) -> tuple[str, str]:
    """The first of the paths that is missing on this node, or "", and the version of Koala on it."""
    return next((path for path in paths if not os.path.exists(path)), ""), version(DISTRIBUTION)


@contextmanager
def _connected(address: str | None) -> Iterator[None]:
    """A connection to a cluster, which prints nothing to the standard output."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a cluster that Ray starts here does not report to its makers
    with redirect_stdout(sys.stderr):
        try:
            _require_listener(address or "")
            context = ray.init(address=address, log_to_driver=False, logging_level=logging.WARNING)
        except (OSError, RuntimeError, ValueError) as error:
            why, remedy = str(error).partition("\n")[0], "give the address that 'ray start --head' printed"
            raise UsageError("cannot join the Ray cluster", where=address or "", why=why, remedy=remedy) from None
        if context.dashboard_url:
            hint(f"Ray's dashboard: http://{context.dashboard_url}")
        try:
            yield
        finally:
            ray.shutdown()


def _require_listener(address: str) -> None:
    """Raise OSError if nobody listens at HOST:PORT: Ray would try for minutes."""
    host, _, port = address.rpartition(":")
    if port.isdecimal():
        socket.create_connection((host.removeprefix("ray://"), int(port)), timeout=ANSWER_S).close()


def _attempt(job: Work) -> tuple[str, str]:
    """Run a job in a worker; the name of its node, and the job's error or ""."""
    node = platform.node()
    return node, attempt(job) if job.log.is_file() else f"{node} does not see {job.log}; {SHARED}"
