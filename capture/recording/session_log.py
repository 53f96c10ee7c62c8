"""The log of a recording: who ran which command on which equipment, and what happened, one line per event.

    2026-11-28T02:38:30.123456Z 5023.123456 move {"joints_deg": [0.0, -90.0, ...], "speed": 0.8, "acceleration": 1.2}

A line has the wall-clock time (UTC), the monotonic clock of the computer [s], the event, and facts about it as JSON. The file
only ever grows. Each line goes to the operating system in one call, so that a killed program leaves whole lines. The lines up to
an event of `FLUSHED` are on the disk once it has happened: a power cut costs at most the lines after the newest picture.
"""

import json
import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from koala3d.capture.drivers.events import EVENTS, event
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError

LOG = "session.log"
START, RECORDING, PICTURE, END, WARNING = "start", "recording", "picture", "end", "warning"
FLUSHED = frozenset({RECORDING, PICTURE, END, WARNING, "stop", "fault", "lamps"})
FINISHED, INTERRUPTED, KILLED = "finished", "stopped by Ctrl-C or from the page", "killed"
MAX_BYTES = 2**28
"""Larger logs are not read; ten thousand pictures make a twentieth of this."""


class SessionLog(logging.Handler):
    """Writes events and warnings to `out/session.log`.

    Nothing is written before the event `recording`: the folder is not there yet, or another process records in it.
    """

    def __init__(self, out: Path) -> None:
        super().__init__(logging.INFO)
        self.path = Path(out) / LOG
        self._waiting: list[bytes] = []
        self._file: int | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """See `logging.Handler`. What cannot be written now, on a full disk, is tried again with the next line."""
        told = record.name == EVENTS.name
        name = record.getMessage() if told else WARNING
        facts = getattr(record, "facts", {}) if told else {"from": record.name, "text": record.getMessage()}
        at = datetime.fromtimestamp(record.created, UTC)
        line = f"{utc(at)} {time.monotonic():.6f} {name} {json.dumps(facts, default=files.plain)}\n"
        self._waiting.append(line.encode())
        if self._file is None and name != RECORDING:
            return
        with suppress(OSError):
            self._write()
            if name in FLUSHED and self._file is not None:
                os.fsync(self._file)

    def _write(self) -> None:
        if self._file is None:
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
            self._file = os.open(self.path, flags, 0o644)
            size = os.fstat(self._file).st_size
            if size and os.pread(self._file, 1, size - 1) != b"\n":  # a power cut or a full disk left half a line
                self._waiting.insert(0, b"\n")
        while self._waiting:
            line = self._waiting[0]
            self._waiting[0] = line[os.write(self._file, line) :]
            if not self._waiting[0]:
                del self._waiting[0]

    def close(self) -> None:
        """See `logging.Handler`."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
        super().close()


@contextmanager
def kept(out: Path, **facts: Any) -> Iterator[None]:
    """Keep the log of the recording `out` while the block runs: its start with some facts, its events, why it ended."""
    log, warned = SessionLog(out), logging.getLogger("koala3d")
    for source in (EVENTS, warned):
        source.addHandler(log)
    event(START, **facts)
    try:
        yield
    except BaseException as error:
        what = INTERRUPTED if isinstance(error, KeyboardInterrupt) else f"{error}" or type(error).__name__
        if isinstance(error, KoalaError):
            event("fault", kind=type(error).__name__, text=what)
        event(END, reason=what)
        raise
    else:
        event(END, reason=FINISHED)
    finally:
        for source in (EVENTS, warned):
            source.removeHandler(log)
        log.close()


def utc(moment: datetime) -> str:
    """A moment as logs and frames state it: 2026-11-28T02:38:30.123456Z."""
    return moment.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def wall_time(host_time_ns: int) -> str:
    """The wall-clock time of a recent moment of the monotonic clock [ns]."""
    return utc(datetime.fromtimestamp(time.time() - (time.monotonic_ns() - host_time_ns) * 1e-9, UTC))


@dataclass(frozen=True)
class LoggedEvent:
    """One line of a log."""

    at: str  # wall-clock time, UTC
    monotonic_s: float
    name: str
    facts: dict[str, Any]


@dataclass(frozen=True)
class LoggedSession:
    """One command that recorded."""

    begun: str  # wall-clock time, UTC
    ended: str  # that of its last line
    reason: str  # why it ended; `KILLED`: it never said so
    pictures: int
    facts: dict[str, Any]  # of its start

    @property
    def line(self) -> str:
        """The session in one line of text."""
        who = f"{self.facts.get('user', '?')} on {self.facts.get('host', '?')}"
        return f"session from {self.begun} to {self.ended} by {who}: {self.pictures} views, {self.reason}"


def read(recording: Path) -> list[LoggedEvent]:
    """The events of a recording's log, in order; empty if it has none. Lines that a power cut spoiled are left out.

    Raises UsageError or DatasetError: the log is no file of text, or too large.
    """
    path = Path(recording) / LOG
    return [one for line in files.read_text(path, MAX_BYTES).split("\n") if (one := _event(line))] if path.exists() else []


def _event(line: str) -> LoggedEvent | None:
    try:
        at, monotonic_s, name, facts = line.split(" ", 3)
        return LoggedEvent(at, float(monotonic_s), name, dict(json.loads(facts)))
    except (ValueError, TypeError, RecursionError):
        return None


def sessions(recording: Path) -> list[LoggedSession]:
    """The sessions of a recording by its log, in order."""
    found: list[list[LoggedEvent]] = []
    for one in read(recording):
        if one.name == START or not found:
            found.append([])
        found[-1].append(one)
    return [_session(events) for events in found]


def _session(events: list[LoggedEvent]) -> LoggedSession:
    first, last = events[0], events[-1]
    reason = str(last.facts.get("reason", "")) if last.name == END else KILLED
    return LoggedSession(first.at, last.at, reason, sum(one.name == PICTURE for one in events), first.facts)
