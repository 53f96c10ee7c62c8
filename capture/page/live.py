"""A recording while it is being made: the newest frame, how it is exposed, how sharp it is, what is left, and a button that stops."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.page.session import CaptureView
from capture.page.timeline import of_recording
from capture.recording.focus import sharpness
from datasets.core.errors import KoalaError
from datasets.imaging import images
from datasets.page.panel import WIDTH, bytes_of
from datasets.recording import MANIFEST, Frame, Recording

POLL_S = 0.5
"""Between two looks at the folder."""
BINS, TALL = 128, 160
"""Bars of the histogram, and its height [px]."""
CLIPPED = 250
"""From this value of 255 on a pixel may have been brighter than the camera can tell."""


class LiveView:
    """Fills a session's page in as its frames come."""

    def __init__(self, session: CaptureView, path: Path, flange_from_camera: NDArray[np.float64]) -> None:
        self.session, self.path, self.flange_from_camera = session, path, flange_from_camera
        self.seen: set[str] = set()
        self._folder = session.page.gui.add_folder("Newest frame", order=-1)
        with self._folder:
            self._words = session.page.gui.add_markdown("*none yet*")
            self._card = session.page.gui.add_image(
                np.full((4, 4, 3), 255, np.uint8), visible=False, format="jpeg", jpeg_quality=90
            )

    def offer_stop(self, stop: Callable[[], None]) -> None:
        """Add the button that stops the arm."""
        with self._folder:
            button = self.session.page.gui.add_button("stop the arm", color="red")
        button.on_click(lambda event: stop())

    def follow(self) -> None:
        """Look at the recording until the page ends."""
        while not self.session.page.stopping.is_set():
            self.look()
            self.session.page.stopping.wait(POLL_S)

    def look(self) -> None:
        """Take what has come since the last look."""
        if not (self.path / MANIFEST).is_file():
            return
        recording = Recording.open(self.path)
        stops = {stop.name: stop for stop in of_recording(recording, self.flange_from_camera).stops}
        new = [frame for frame in recording.frames if frame.name not in self.seen and frame.name in self.session.stops]
        for frame in new:
            if self.session.page.stopping.is_set():
                return
            self.session.taken(stops[frame.name])
            self.seen.add(frame.name)
        if new:
            self._show(new[-1], recording)

    def _show(self, frame: Frame, recording: Recording) -> None:
        session = self.session
        planned = session.stops[frame.name].seconds
        if planned is not None:
            session.slider.value = planned
        remaining = session.timeline.end - (planned or 0.0)
        words = f"view {frame.name}, {len(self.seen)} of {len(session.stops)} taken; about {remaining:.0f} s of the plan are left"
        try:
            pixels = images.read_stored(recording.image_path(frame))
        except KoalaError as error:
            self._words.content = f"{words}\n\n{error}"
            return
        card, clipped = with_histogram(bytes_of(pixels if pixels.dtype == np.uint8 else pixels / np.float32(65535), WIDTH))
        self._card.image, self._card.visible = card, True
        self._words.content = (f"{words}  \nexposed for {1e-3 * frame.exposure_us:g} ms, {100 * clipped:.1f} % of the pixels are clipped  \n"
                               f"sharpness {sharpness(pixels[..., :3]):.2f}")  # fmt: skip


def with_histogram(picture: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], float]:
    """(height + TALL, width, 3) a picture with the histograms of its channels beneath, and the share of clipped pixels.

    Args:
        picture: (height, width, 3) sRGB bytes. The right end of the histogram is white.
    """
    drawn = np.full((TALL, picture.shape[1], 3), 255, np.uint8)
    columns = (np.arange(picture.shape[1]) * BINS) // picture.shape[1]
    heights = np.arange(TALL, 0, -1)[:, None]
    for channel in range(3):
        counts, _ = np.histogram(picture[..., channel], bins=BINS, range=(0, 256))
        tall = (TALL * np.sqrt(counts / max(counts.max(), 1)))[columns]
        others = [other for other in range(3) if other != channel]
        drawn[..., others] = np.where((heights <= tall)[..., None], drawn[..., others] // 2, drawn[..., others])
    return np.concatenate([picture, drawn]), float((picture >= CLIPPED).any(-1).mean())
