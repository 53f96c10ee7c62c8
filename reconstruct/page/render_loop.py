"""Who looks, and whose picture comes next: every browser gets a coarse picture at once, then finer ones while it holds still."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser

from datasets import pose
from datasets.page import Page
from reconstruct.page.compose import Viewpoint

LEVELS = (2048, 8192, 32768, 131072, 524288)
"""Rays of the pictures, one after the other."""
Cancelled = Callable[[], bool]
Paint = Callable[[viser.ClientHandle, Viewpoint, int, Cancelled], None]
"""Render for a browser from an eye with so many rays, and show it; gives up, showing nothing, once it is cancelled."""


@dataclass
class _Watcher:
    client: viser.ClientHandle
    moves: int = 0
    done: int = 0
    """Levels that the picture from here has been shown at."""


class RenderLoop:
    """All browsers of a page. Pictures are made one at a time, by one thread."""

    def __init__(self, page: Page, paint: Paint, *, moved: Callable[[], None] = lambda: None) -> None:
        """Begin to watch; `moved` is called whenever somebody moves."""
        self._page, self._paint, self._somebody_moved = page, paint, moved
        self._watchers: dict[int, _Watcher] = {}
        self._changed = threading.Condition()
        self.levels = 4
        """How many of `LEVELS` are gone through; 0 stops the rendering."""
        page.server.on_client_connect(self._arrived)
        page.server.on_client_disconnect(self._left)

    def _arrived(self, client: viser.ClientHandle) -> None:
        with self._changed:
            self._watchers[client.client_id] = _Watcher(client)
            self._changed.notify()
        client.camera.on_update(lambda camera: self._turned(client.client_id))

    def _left(self, client: viser.ClientHandle) -> None:
        with self._changed:
            self._watchers.pop(client.client_id, None)

    def _turned(self, client_id: int) -> None:
        self._somebody_moved()
        self._moved(client_id)

    def _moved(self, client_id: int) -> None:
        with self._changed:
            watcher = self._watchers.get(client_id)
            if watcher is not None:
                watcher.moves, watcher.done = watcher.moves + 1, 0
                self._changed.notify()

    def again(self) -> None:
        """Make all pictures anew: the model, or what is to be seen of it, has changed."""
        for client_id in list(self._watchers):
            self._moved(client_id)

    def run(self) -> None:
        """Make pictures until the page ends."""
        while not self._page.stopping.is_set():
            with self._changed:
                waiting = [watcher for watcher in self._watchers.values() if watcher.done < self.levels]
                if not waiting:
                    self._changed.wait(0.1)
                    continue
            self._serve(min(waiting, key=lambda watcher: watcher.done))

    def _serve(self, watcher: _Watcher) -> None:
        """One picture for one browser. The coarsest is finished even while it moves; finer ones are given up."""
        moves, level, key = watcher.moves, watcher.done, watcher.client.client_id

        def cancelled() -> bool:
            gone = self._page.stopping.is_set() or key not in self._watchers
            return gone or (level > 0 and watcher.moves != moves)

        self._paint(watcher.client, viewpoint_of(watcher.client), LEVELS[level], cancelled)
        with self._changed:
            if watcher.moves == moves:
                watcher.done = level + 1


def viewpoint_of(client: viser.ClientHandle) -> Viewpoint:
    """Where a browser looks from now."""
    camera = client.camera
    matrix = pose.from_quaternion(np.asarray(camera.wxyz), np.asarray(camera.position))
    return Viewpoint(matrix, float(camera.fov), float(camera.image_width / max(camera.image_height, 1)))
