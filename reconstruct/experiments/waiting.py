"""What runs jobs, here or on a cluster, and what it has to know of one: its files, what it needs, how much work is left."""

import ctypes
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

LOOK_S = 2.0
"""Time after which more jobs are asked for where none has ended."""


@dataclass(frozen=True)
class Needs:
    """What a job occupies on a node of a cluster while it runs."""

    cores: float = 1.0
    memory_gb: float = 0.0  # 0: any
    gpus: float | None = None  # share of a GPU; None: one, if the cluster has any


class Work(Protocol):
    """A job: a training of a sweep, or a step of a series."""

    @property
    def name(self) -> str:
        """For messages."""
        ...

    @property
    def log(self) -> Path:
        """File with what its processes write to their terminals."""
        ...

    @property
    def result(self) -> Path:
        """File that is there once it is done."""
        ...

    @property
    def done(self) -> bool:
        """Whether there is a result."""
        ...

    @property
    def needs(self) -> Needs:
        """What it occupies."""
        ...

    @property
    def left_s(self) -> float:
        """Time that it and what follows it will take [s]; 0 where nobody estimates it."""
        ...

    def attempt(self) -> str:
        """Run unless it is done; the error, or ""."""
        ...


W = TypeVar("W", bound=Work)
Batches = Iterable[Sequence[W]]
"""Jobs that can start, asked for at the beginning, after each end, and every `LOOK_S`; it ends when no more will come."""
Runner = Callable[[Batches[W]], Iterator[tuple[W, str | None]]]
"""Runs jobs; yields each as it begins, with None, and when it has ended, with its error or ""."""


class Waiting(list[W]):
    """Jobs that wait for their turn, as they come."""

    def __init__(self, batches: Batches[W]) -> None:
        super().__init__()
        self._batches = iter(batches)
        self.open = True
        """Whether more may come."""

    def look(self) -> None:
        """Take in what has come."""
        batch = next(self._batches, None) if self.open else None
        self.open = batch is not None
        self.extend(batch or ())


def end_with(parent: int) -> None:
    """Let the system kill this process when the one that started it has died: nobody would know of it any more. Linux only.

    Args:
        parent: number of the process that has started this one.
    """
    if sys.platform == "linux":
        set_death_signal = 1  # PR_SET_PDEATHSIG in linux/prctl.h
        ctypes.CDLL(None).prctl(set_death_signal, signal.SIGKILL)
        if os.getppid() != parent:  # it had died before
            os.kill(os.getpid(), signal.SIGKILL)
