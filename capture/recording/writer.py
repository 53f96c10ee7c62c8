"""Writes frames to disk while the arm moves to the next view: encoding a picture takes longer than taking it."""

import queue
import threading
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Self

from capture.measurements import Pixels
from datasets.core import files
from datasets.imaging import images
from datasets.recording import Frame, Recording

Advance = Callable[[str], None]
WAITING = 2  # frames that may be queued for the disk; if it is slower than the arm, the arm waits


class Writer:
    """A thread that writes each frame, first the image, then the line, in the given order. Use as a context manager.

    Leaving waits until everything is on the disk, also after an exception: a picture that was taken is kept. An error in
    the thread (a full disk) is raised by the next `put`, or on leaving.
    """

    def __init__(self, recording: Recording, advance: Advance) -> None:
        self.recording, self.advance = recording, advance
        self._queue: queue.Queue[tuple[Frame, Pixels] | None] = queue.Queue(WAITING)
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="frame writer", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._queue.put(None)
        self._thread.join()
        if kind is None and self._failure is not None:
            raise self._failure

    def put(self, frame: Frame, pixels: Pixels) -> None:
        """Hand over a frame, whose hash is filled in here, and its picture; blocks while the queue is full."""
        if self._failure is not None:
            raise self._failure
        self._queue.put((frame, pixels))

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            if self._failure is not None:
                continue  # keep emptying the queue, or `put` would block for ever
            try:
                self._write(*item)
            except Exception as error:  # raised in the thread that calls `put`
                self._failure = error

    def _write(self, frame: Frame, pixels: Pixels) -> None:
        path = self.recording.path / frame.image
        images.write(path, pixels)
        self.recording.append(replace(frame, sha256=files.sha256(path)))
        self.advance(frame.name)
