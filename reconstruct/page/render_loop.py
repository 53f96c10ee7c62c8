"""Renders for all browsers of a page: each gets a coarse picture at once, then finer ones while its camera rests."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser

from koala3d.datasets import pose
from koala3d.datasets.page import Page
from koala3d.reconstruct.page.compose import Viewpoint

LEVELS = (2048, 8192, 32768, 131072, 524288)  # rays per picture, from coarse to fine
Cancelled = Callable[[], bool]
Paint = Callable[[viser.ClientHandle, Viewpoint, int, Cancelled], None]
"""Render a viewpoint with a number of rays and show the picture in a browser, unless it is cancelled."""


@dataclass
class _Browser:
    client: viser.ClientHandle
    moves: int = 0
    done: int = 0  # number of levels shown from the current viewpoint


class RenderLoop:
    """The browsers of a page. One thread renders one picture at a time."""

    def __init__(self, page: Page, paint: Paint, *, moved: Callable[[], None] = lambda: None) -> None:
        """Register with the page; `moved` is called whenever a browser's camera moves."""
        self._page, self._paint, self._on_move = page, paint, moved
        self._browsers: dict[int, _Browser] = {}
        self._changed = threading.Condition()
        self.levels = 4
        """Number of `LEVELS` to render; 0 stops rendering."""
        page.server.on_client_connect(self._arrived)
        page.server.on_client_disconnect(self._left)

    def _arrived(self, client: viser.ClientHandle) -> None:
        with self._changed:
            self._browsers[client.client_id] = _Browser(client)
            self._changed.notify()
        client.camera.on_update(lambda camera: self._turned(client.client_id))

    def _left(self, client: viser.ClientHandle) -> None:
        with self._changed:
            self._browsers.pop(client.client_id, None)

    def _turned(self, client_id: int) -> None:
        self._on_move()
        self._moved(client_id)

    def _moved(self, client_id: int) -> None:
        with self._changed:
            browser = self._browsers.get(client_id)
            if browser is not None:
                browser.moves, browser.done = browser.moves + 1, 0
                self._changed.notify()

    def restart(self) -> None:
        """Render all pictures again, because the model or the display options changed."""
        for client_id in list(self._browsers):
            self._moved(client_id)

    def run(self) -> None:
        """Render until the page ends."""
        while not self._page.stopping.is_set():
            with self._changed:
                waiting = [browser for browser in self._browsers.values() if browser.done < self.levels]
                if not waiting:
                    self._changed.wait(0.1)
                    continue
            self._serve(min(waiting, key=lambda browser: browser.done))

    def _serve(self, browser: _Browser) -> None:
        """One picture for one browser. Moving cancels it unless it is the coarsest."""
        moves, level, key = browser.moves, browser.done, browser.client.client_id

        def cancelled() -> bool:
            gone = self._page.stopping.is_set() or key not in self._browsers
            return gone or (level > 0 and browser.moves != moves)

        self._paint(browser.client, viewpoint_of(browser.client), LEVELS[level], cancelled)
        with self._changed:
            if browser.moves == moves:
                browser.done = level + 1


def viewpoint_of(client: viser.ClientHandle) -> Viewpoint:
    """The current viewpoint of a browser."""
    camera = client.camera
    matrix = pose.from_quaternion(np.asarray(camera.wxyz), np.asarray(camera.position))
    return Viewpoint(matrix, float(camera.fov), float(camera.image_width / max(camera.image_height, 1)))
