"""Writes frames to disk while the arm moves to the next view: encoding a picture takes longer than taking it."""

import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import TracebackType
from typing import Self

from koala3d.capture.drivers.events import event
from koala3d.capture.drivers.measurements import Image
from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.radiometry.stored import RAW_FOLDER, DepthPicture, Exposure, packed
from koala3d.datasets.recording import DEPTH, Frame, Recording

Advance = Callable[[str], None]
TakenView = list[tuple[Frame, list[Image]]]
"""What each camera took while the arm stood at one view: a frame, without hashes, and its exposures, longest first."""
WAITING = 2  # stops that may be queued for the disk; if it is slower than the arm, the arm waits


class Writer:
    """A thread that writes each frame, first the image, then the line, in the given order. Use as a context manager.

    Args:
        recordings: one for each camera. A frame of that name in one of them is replaced: another camera lacked its own.
        advance: called with the name of each view that all cameras have on the disk.

    Leaving waits until everything is on the disk, also after an exception: a picture that was taken is kept. An error in
    the thread (a full disk) is raised by the next `put`, or on leaving.
    """

    def __init__(self, recordings: Sequence[Recording], advance: Advance) -> None:
        self.recordings, self.advance = recordings, advance
        self._queue: queue.Queue[TakenView | None] = queue.Queue(WAITING)
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

    def put(self, stop: TakenView) -> None:
        """Hand over what was taken at a view, in the order of the recordings; blocks while the queue is full."""
        if self._failure is not None:
            raise self._failure
        self._queue.put(stop)

    def _work(self) -> None:
        while (stop := self._queue.get()) is not None:
            if self._failure is not None:
                continue  # keep emptying the queue, or `put` would block for ever
            try:
                for recording, (frame, taken) in zip(self.recordings, stop, strict=True):
                    _write(recording, frame, taken)
                event(
                    "picture",
                    view=stop[0][0].name,
                    wall_time=stop[0][0].wall_time,
                    sha256=[one.frames[-1].sha256 for one in self.recordings],
                )
                self.advance(stop[0][0].name)
            except Exception as error:  # raised in the thread that calls `put`
                event("fault", kind=type(error).__name__, text=f"view {stop[0][0].name} cannot be written: {error}")
                self._failure = error


def _write(recording: Recording, frame: Frame, taken: list[Image]) -> None:
    recording.discard({frame.name})
    path = recording.path / frame.image
    images.write(path, taken[0].pixels)
    exposures = tuple(_exposure(recording, frame, number, image) for number, image in enumerate(taken))
    needed = len(taken) > 1 or taken[0].raw is not None  # else the image is all there is
    depth = _depth(recording, frame, taken[0])
    recording.append(replace(frame, sha256=files.sha256(path), exposures=exposures if needed else (), depth=depth))


def _depth(recording: Recording, frame: Frame, image: Image) -> DepthPicture | None:
    """Write the depth that the camera measured with the first exposure."""
    if image.depth is None:
        return None
    name = f"{DEPTH}/{frame.name}.png"
    images.write(recording.path / name, image.depth[..., None])
    return DepthPicture(name, files.sha256(recording.path / name))


def _exposure(recording: Recording, frame: Frame, number: int, image: Image) -> Exposure:
    """Write what the sensor read; the developed picture of the first exposure is the image, which is there already."""
    suffix = f"_{number}" if number else ""
    name = frame.image if image.raw is None else f"{RAW_FOLDER}/{frame.name}.png"
    name = name.replace(".png", f"{suffix}.png")
    path = recording.path / name
    if name != frame.image:
        images.write(path, image.pixels if image.raw is None else packed(image.raw))
    return Exposure(name, image.exposure_us, files.sha256(path))
