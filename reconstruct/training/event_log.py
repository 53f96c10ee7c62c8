"""The log of a training for TensorBoard: a scalar per figure and loss.

RUN/events.out.tfevents.*    beside log.jsonl, one file per start of the training
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from koala3d.datasets.core.errors import UsageError


def scalars_of(line: dict[str, Any]) -> dict[str, float]:
    """Figures of a line of the log by the names that they get here: losses in a group of their own."""
    found = {name: float(value) for name, value in line.items() if name not in ("step", "terms")}
    return found | {f"loss/{name}": float(value) for name, value in line.get("terms", {}).items()}


def require_writer() -> None:
    """Raise UsageError where what writes such files is not installed: before a training begins."""
    _tensorboardx()


class EventLog:
    """One event file; opened by `event_log`."""

    def __init__(self, run: Path, step: int) -> None:
        files, self._events = _tensorboardx()
        resumed = step > 0 or any(run.glob("events.out.*"))
        self._file = files.EventsWriter(str(run / "events"), f".{step}")
        if resumed:
            begun = self._events.SessionLog(status=self._events.SessionLog.START)
            self._add(step=step + 1, session_log=begun)

    def write(self, line: dict[str, Any]) -> None:
        """Add the figures of a line of the log, at its step; they are in the file when this returns."""
        values = [{"tag": name, "simple_value": value} for name, value in scalars_of(line).items()]
        self._add(step=line["step"], summary={"value": values})

    def close(self) -> None:
        """Nothing can be added any more."""
        self._file.close()

    def _add(self, **content: Any) -> None:
        self._file.write_event(self._events.Event(wall_time=time.time(), **content))
        self._file.flush()


@contextmanager
def event_log(run: Path, *, wanted: bool, step: int = 0) -> Iterator[EventLog | None]:
    """An event file of a run, or None where nobody wants it.

    Args:
        step: where the training begins; it replaces what the files of an interrupted training say of later steps.

    Raises:
        UsageError: it is wanted, and its writer is not installed.
    """
    if not wanted:
        yield None
        return
    log = EventLog(run, step)
    try:
        yield log
    finally:
        log.close()


def _tensorboardx() -> tuple[Any, Any]:
    """Modules that write event files and that know what an event is."""
    try:
        from tensorboardX import event_file_writer
        from tensorboardX.proto import event_pb2
    except ImportError:
        raise UsageError(
            "TensorBoard's files cannot be written",
            why="tensorboardX is not installed",
            remedy="pip install 'koala-capture[tensorboard]', or leave train.tensorboard out",
        ) from None
    return event_file_writer, event_pb2
