"""A recording while it is made: the newest frame, its exposure and sharpness, the remaining time, and a stop button."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.page.session import CaptureView
from koala3d.capture.page.timeline import of_recording
from koala3d.capture.recording.focus import sharpness
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.imaging import images
from koala3d.datasets.page.panel import WIDTH, bytes_of
from koala3d.datasets.recording import MANIFEST, Frame, Recording

POLL_S = 0.5  # period of the checks of the folder
BINS, TALL = 128, 160  # bars of the histogram, and its height [px]
CLIPPED = 250  # a pixel counts as clipped from this value of 255


class LiveView:
    """Adds the frames of a recording to the page of its session as they arrive."""

    def __init__(self, session: CaptureView, path: Path, mount: Carrier) -> None:
        self.session, self.path, self.mount = session, path, mount
        self.seen: set[str] = set()
        self._folder = session.page.gui.add_folder("Newest frame", order=-1)
        with self._folder:
            self._words = session.page.gui.add_markdown("*none yet*")
            white = np.full((4, 4, 3), 255, np.uint8)
            self._card = session.page.gui.add_image(white, visible=False, format="jpeg", jpeg_quality=90)

    def offer_stop(self, stop: Callable[[], None]) -> None:
        """Add the button that stops the arm."""
        with self._folder:
            button = self.session.page.gui.add_button("stop the arm", color="red")
        button.on_click(lambda event: stop())

    def follow(self) -> None:
        """Check the recording for new frames until the page ends."""
        while not self.session.page.stopping.is_set():
            self.update()
            self.session.page.stopping.wait(POLL_S)

    def update(self) -> None:
        """Show the frames that are new since the last call."""
        if not (self.path / MANIFEST).is_file():
            return
        recording = Recording.open(self.path)
        stops = {stop.name: stop for stop in of_recording(recording, self.mount).stops}
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
        words = f"view {frame.name}, {len(self.seen)} of {len(session.stops)} taken; about {remaining:.0f} s remain"
        try:
            pixels = images.read_stored(recording.image_path(frame))
        except KoalaError as error:
            self._words.content = f"{words}\n\n{error}"
            return
        card, clipped = with_histogram(bytes_of(pixels if pixels.dtype == np.uint8 else pixels / np.float32(65535), WIDTH))
        self._card.image, self._card.visible = card, True
        exposed = f"exposed for {1e-3 * frame.exposure_us:g} ms, {100 * clipped:.1f} % of the pixels are clipped"
        self._words.content = f"{words}  \n{exposed}  \nsharpness {sharpness(pixels[..., :3]):.2f}"


def with_histogram(picture: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], float]:
    """(height + TALL, width, 3) picture with the histograms of its channels below it, and the share of clipped pixels.

    Args:
        picture: (height, width, 3) sRGB bytes. White is at the right end of the histogram.
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
