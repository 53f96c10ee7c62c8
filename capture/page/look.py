"""The live picture of a camera, with marks for focus and clipping, and what it says about exposure, lamps and colours."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.measurements import Image
from koala3d.capture.drivers.protocols import Camera
from koala3d.capture.page.jogging import JogPanel
from koala3d.capture.page.live import with_histogram
from koala3d.capture.page.overlay import shown
from koala3d.capture.sessions.live import flicker
from koala3d.capture.sessions.live.analysis import Look, Part
from koala3d.capture.sessions.live.balance import stored_response, white_balance, words
from koala3d.capture.sessions.live.jog import Jog
from koala3d.capture.sessions.live.outline import Outline
from koala3d.capture.sessions.live.teach import Teaching
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.page import Page

PAUSE_S = 0.1
"""Between two pictures."""
LONGEST_S = 10.0
"""How long the end of the page waits for the picture that is being taken."""
WIDE = 480  # width of the histogram [px]
AROUND = 40  # grey beside the picture [of 255]


class LookPage:
    """Grabs pictures in the background and shows them until the page ends.

    Only the background thread uses camera and arm; buttons leave it a task, all but the one that stops the arm.
    """

    def __init__(
        self,
        page: Page,
        camera: Camera,
        part: Part,
        *,
        burst: int,
        balance: Path | None,
        stored: str,
        jog: Jog | None = None,
        outline: Outline | None = None,
        teaching: Teaching | None = None,
    ) -> None:
        self.page, self.camera, self.part = page, camera, part
        self.jog, self.outline = jog, outline
        self.burst, self.balance, self.stored = burst, balance, stored
        self.best, self._tasks, self._lock = 0.0, [], threading.Lock()
        self._ended = threading.Event()
        self._size: tuple[int, int] | None = None
        gui = page.gui
        self._words = gui.add_markdown("*waiting for the first picture*")
        self._focus = gui.add_progress_bar(0.0)
        self._histogram = gui.add_image(np.full((4, 4, 3), 255, np.uint8), label="histogram", format="jpeg", jpeg_quality=90)
        self._peaking, self._zebra = gui.add_checkbox("focus peaking", True), gui.add_checkbox("zebra on clipped pixels", True)
        self._exposure = gui.add_number("exposure [ms]", 10.0, min=0.001, step=0.1)
        self._exposure.on_update(lambda event: self._later(self._expose))
        gui.add_button("use the suggested exposure").on_click(lambda event: self._later(self._suggest))
        gui.add_button("measure flicker").on_click(lambda event: self._later(self._flicker))
        self._lamps = gui.add_markdown("*flicker is not measured yet*")
        if balance is not None:
            gui.add_button("store the region's white balance").on_click(lambda event: self._later(self._balance))
        self._stored = gui.add_markdown("" if balance is not None else "*--balance FLAT.npz stores a white balance*")
        if jog is not None:
            JogPanel(gui, jog, self._later, teaching)
        self.newest: Look | None = None
        page.in_background(self._follow)

    def _later(self, task: Callable[[], None]) -> None:
        with self._lock:
            self._tasks.append(task)

    def end(self) -> None:
        """Stop using the camera; returns when it may be closed."""
        self.page.stopping.set()
        self._ended.wait(LONGEST_S)

    def _follow(self) -> None:
        try:
            self._loop()
        finally:
            self._ended.set()

    def _loop(self) -> None:
        while not self.page.stopping.is_set():
            with self._lock:
                tasks, self._tasks = self._tasks, []
            try:
                for task in tasks:
                    task()
                self._show(self.camera.grab())
            except KoalaError as error:
                self.page.say("Something went wrong", str(error))
            self.page.stopping.wait(PAUSE_S)

    def _show(self, image: Image) -> None:
        if self._size is None:
            self._begin(image)
        look = self.newest = Look.at(image, self.part)
        marked = shown(image.pixels, self.part, peaking=self._peaking.value, zebra=self._zebra.value)
        if self.jog is not None and self.outline is not None:
            state = self.jog.robot.state()
            marked = self.outline.drawn(marked, state.base_from_flange, state.joints)
        for client in self.page.server.get_clients().values():
            client.scene.set_background_image(framed(marked, client.camera.aspect), format="jpeg", jpeg_quality=85)
        plain = shown(image.pixels, self.part, peaking=False, zebra=False, width=WIDE)
        self._histogram.image = with_histogram(plain)[0][len(plain) :]
        self.best = max(self.best, look.focus)
        self._focus.value = 100 * look.focus / self.best
        self._words.content = "  \n".join([*look.lines, f"best focus so far: {self.best:.3f}"])

    def _begin(self, image: Image) -> None:
        height, width = image.pixels.shape[:2]
        self._size = (width, height)
        self._exposure.value = 1e-3 * image.exposure_us
        part, gui = self.part, self.page.gui
        columns: Any = gui.add_multi_slider("columns", 0, width, 1, (part.left, part.right), min_range=16)
        rows: Any = gui.add_multi_slider("rows", 0, height, 1, (part.top, part.bottom), min_range=16)

        def moved(event: Any) -> None:
            self.part, self.best = Part(columns.value[0], rows.value[0], columns.value[1], rows.value[1]), 0.0

        columns.on_update(moved)
        rows.on_update(moved)

    def _expose(self) -> None:
        self.camera.set_exposure(1e3 * self._exposure.value)

    def _suggest(self) -> None:
        if self.newest is not None:
            self.camera.set_exposure(self.newest.suggested_us)
            self._exposure.value = 1e-3 * self.newest.suggested_us

    def _flicker(self) -> None:
        self._lamps.content = "*measuring*"
        known = stored_response(self.camera, self.stored)
        self._lamps.content = flicker.flicker(*flicker.burst(self.camera, self.part, self.burst, response=known)).line

    def _balance(self) -> None:
        if self.balance is not None:
            found = white_balance(self.camera, self.part, self.stored)
            found.save(self.balance)
            self._stored.content = f"{words(found)}  \nstored in {self.balance}"


def framed(picture: NDArray[np.uint8], aspect: float) -> NDArray[np.uint8]:
    """The picture in the middle of a grey one whose width is `aspect` times its height: a window shows it undistorted."""
    height, width = picture.shape[:2]
    tall, wide = max(height, round(width / aspect)), max(width, round(height * aspect))
    top, left = (tall - height) // 2, (wide - width) // 2
    whole = np.full((tall, wide, 3), AROUND, np.uint8)
    whole[top : top + height, left : left + width] = picture
    return whole
