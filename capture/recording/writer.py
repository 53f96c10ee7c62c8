"""Writes frames to disk while the arm moves to the next view: encoding a picture takes longer than taking it."""

import queue
import threading
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Self

from capture.measurements import Image
from datasets.core import files
from datasets.imaging import images
from datasets.radiometry.stored import RAW_FOLDER, packed
from datasets.recording import DEPTH, DepthPicture, Exposure, Frame, Recording

Advance = Callable[[str], None]
WAITING = 2  # frames that may be queued for the disk; if it is slower than the arm, the arm waits


class Writer:
    """A thread that writes each frame, first the image, then the line, in the given order. Use as a context manager.

    Leaving waits until everything is on the disk, also after an exception: a picture that was taken is kept. An error in
    the thread (a full disk) is raised by the next `put`, or on leaving.
    """

    def __init__(self, recording: Recording, advance: Advance) -> None:
        self.recording, self.advance = recording, advance
        self._queue: queue.Queue[tuple[Frame, list[Image]] | None] = queue.Queue(WAITING)
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

    def put(self, frame: Frame, taken: list[Image]) -> None:
        """Hand over a frame, without hashes, and its exposures, longest first; blocks while the queue is full."""
        if self._failure is not None:
            raise self._failure
        self._queue.put((frame, taken))

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            if self._failure is not None:
                continue  # keep emptying the queue, or `put` would block for ever
            try:
                self._write(*item)
            except Exception as error:  # raised in the thread that calls `put`
                self._failure = error

    def _write(self, frame: Frame, taken: list[Image]) -> None:
        path = self.recording.path / frame.image
        images.write(path, taken[0].pixels)
        exposures = tuple(self._exposure(frame, number, image) for number, image in enumerate(taken))
        needed = len(taken) > 1 or taken[0].raw is not None  # else the image is all there is
        depth = self._depth(frame, taken[0])
        self.recording.append(replace(frame, sha256=files.sha256(path), exposures=exposures if needed else (), depth=depth))
        self.advance(frame.name)

    def _depth(self, frame: Frame, image: Image) -> DepthPicture | None:
        """Write the depth that the camera measured with the first exposure."""
        if image.depth is None:
            return None
        name = f"{DEPTH}/{frame.name}.png"
        images.write(self.recording.path / name, image.depth[..., None])
        return DepthPicture(name, files.sha256(self.recording.path / name))

    def _exposure(self, frame: Frame, number: int, image: Image) -> Exposure:
        """Write what the sensor read; the developed picture of the first exposure is the image, which is there already."""
        suffix = f"_{number}" if number else ""
        name = frame.image if image.raw is None else f"{RAW_FOLDER}/{frame.name}.png"
        name = name.replace(".png", f"{suffix}.png")
        path = self.recording.path / name
        if name != frame.image:
            images.write(path, image.pixels if image.raw is None else packed(image.raw))
        return Exposure(name, image.exposure_us, files.sha256(path))
