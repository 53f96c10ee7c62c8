"""One training on several machines: a process on each runs the same program, and every batch is divided among all their devices.

Each process reads the scene and takes each step. What may differ from machine to machine (clocks, memory, Ctrl-C, the last digits
of a rendering) is decided by the first process for all. It alone writes the run; the others write into a temporary folder.

In a training of one process nothing here talks to anybody.
"""

import hashlib
import os
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.console import hint
from koala3d.datasets.core.errors import KoalaError, UsageError
from koala3d.datasets.core.files import refuse_existing
from koala3d.reconstruct.errors import ReconstructError

JOIN_S, SILENCE_S, LEAVE_S = 300, 60, 20
"""Seconds that a process waits for the others to come; after which one that is silent counts as lost; and to leave together."""
LOOPBACK = ("127.0.0.1", "localhost")
Tree = TypeVar("Tree")


def join(coordinator: str | None, processes: int | None, process: int | None) -> None:
    """Make this process one of several; before JAX has touched a device. Nothing where no argument is given.

    Args:
        coordinator: HOST:PORT of the first process, which listens there.
        processes: how many there are.
        process: which of them this is, from 0.

    Raises:
        UsageError: one of the three is missing, or impossible.
        ReconstructError: the processes did not find each other.
    """
    if coordinator is None and processes is None and process is None:
        return
    if coordinator is None or processes is None or process is None:
        raise UsageError(
            "give --coordinator, --processes and --process together", remedy="or none of them, to train in one process"
        )
    host, _, port = coordinator.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise UsageError("is not HOST:PORT", where=f"--coordinator {coordinator}", remedy="write it like 192.168.0.7:8476")
    if not 0 <= process < processes:
        raise UsageError(f"there is no process {process} of {processes}", where="--process", remedy="they count from 0")
    if process:
        _reach(host, int(port))
    else:
        _require_free(host, int(port))
        hint(f"waits {JOIN_S} s at most for {processes - 1} more processes at {coordinator}")
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    jax.config.update("jax_enable_preemption_service", False)  # it would keep a process from ending on a signal
    try:
        jax.distributed.initialize(
            coordinator,
            processes,
            process,
            cluster_detection_method="deactivate",
            initialization_timeout=JOIN_S,
            heartbeat_timeout_seconds=SILENCE_S,
            shutdown_timeout_seconds=LEAVE_S,
            coordinator_bind_address=coordinator if host in LOOPBACK else None,
        )
    except RuntimeError as error:
        raise ReconstructError(
            "the processes did not find each other",
            where=coordinator,
            why=str(error).splitlines()[0],
            remedy=f"start all {processes} within {JOIN_S} s, each with its own --process",
        ) from None
    with _output_aside():
        gathered([0.0])  # gloo greets its peers


def _reach(host: str, port: int) -> None:
    """Wait until the first process listens. JAX by itself would end this process without a usable error."""
    deadline = time.monotonic() + JOIN_S
    while True:
        try:
            return socket.create_connection((host, port), timeout=5).close()
        except OSError as error:
            if time.monotonic() > deadline or isinstance(error, socket.gaierror):
                raise ReconstructError(
                    "the first process cannot be reached",
                    where=f"{host}:{port}",
                    why=error.strerror or str(error),
                    remedy=f"start it within {JOIN_S} s, at an address and port that others reach",
                ) from None
        time.sleep(0.2)


def _require_free(host: str, port: int) -> None:
    """Raise UsageError where somebody listens at the port already: JAX would share it with them."""
    try:
        with socket.create_server((host if host in LOOPBACK else "", port)):
            return
    except OSError as error:
        raise UsageError(
            "the first process cannot listen there",
            where=f"--coordinator {host}:{port}",
            why=error.strerror or str(error),
            remedy="choose another port, in all processes",
        ) from None


@contextmanager
def _output_aside() -> Iterator[None]:
    """Whatever a library prints goes to where errors go: standard output is the result's."""
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def gathered(values: Sequence[float] | NDArray[np.uint8]) -> NDArray[np.float64]:
    """(processes, n) what each process says; every process must ask, and with as many values. Exact in float64."""
    own = np.asarray(values, np.float64)
    if jax.process_count() == 1:
        return own[None]
    from jax.experimental.multihost_utils import process_allgather

    return np.asarray(process_allgather(own.view(np.uint32))).view(np.float64)


def decided(value: float) -> float:
    """What the first process says."""
    return float(gathered([value])[0, 0])


def decided_text(text: str) -> str:
    """The same of a text."""
    if jax.process_count() == 1:
        return text
    data = text.encode()
    length = int(decided(len(data)))
    return gathered(np.frombuffer(data[:length].ljust(length, b" "), np.uint8))[0].astype(np.uint8).tobytes().decode()


def require_same(tree: Any, what: str) -> None:
    """Raise UsageError in every process where one has other arrays than the first: those that do not see the same scene, say."""
    if jax.process_count() == 1:
        return
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        digest.update(np.ascontiguousarray(leaf).tobytes())
    said = gathered(np.frombuffer(digest.digest(), np.uint8))
    others = np.flatnonzero((said != said[0]).any(-1))
    if len(others):
        raise UsageError(
            f"process {others[0]} has another {what} than the first", remedy="give all of them the same files and settings"
        )


def on_all(tree: Tree, sharding: jax.sharding.Sharding) -> Tree:
    """Arrays that every process has as a whole, whole on each device."""
    place = lambda whole: jax.make_array_from_callback(whole.shape, sharding, lambda part: whole[part])  # noqa: E731
    return jax.tree.map(lambda leaf: place(np.asarray(leaf)), tree)


def own_copy(tree: Tree) -> Tree:
    """Arrays that are whole on each device as this process's first device has them: for what it does by itself."""
    return jax.tree.map(lambda leaf: leaf.addressable_data(0) if isinstance(leaf, jax.Array) else leaf, tree)


def writes() -> bool:
    """Whether this process writes what others are to read."""
    return jax.process_index() == 0


@contextmanager
def folder_for(out: Path, *, resume: bool = False) -> Iterator[Path]:
    """Where this process writes its run: `out` in the first, elsewhere a copy of it that is thrown away.

    Raises:
        UsageError: `out` holds something, or with `resume` no process but the first sees it.
        ReconstructError: the first process could not begin; its own line says why.
    """
    problem: KoalaError | None = None
    if not resume and writes():
        try:
            refuse_existing(out)
        except KoalaError as error:
            problem = error
    if resume and not out.is_dir():
        problem = UsageError("is not a run", where=out, remedy="all processes must see it under this path")
    failed = np.flatnonzero(gathered([problem is not None])[:, 0])
    if problem is not None:
        raise problem
    if len(failed):
        raise ReconstructError(f"process {failed[0]} could not begin", remedy="its own line says why")
    if writes():
        yield out
        return
    with tempfile.TemporaryDirectory(prefix="koala-") as scratch:
        folder = Path(scratch) / out.name
        if resume:
            shutil.copytree(out, folder)
        yield folder
