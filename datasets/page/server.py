"""A page in the browser: served on 127.0.0.1, complete in itself, gone within a second of Ctrl-C.

The browser gets one file with everything in it and then talks to this process through a web socket; nothing is fetched
from elsewhere, and nothing is offered to elsewhere. From another computer: `ssh -L 8080:127.0.0.1:8080 HOST`.
"""

import contextlib
import io
import logging
import os
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NoReturn

import viser
from numpy.typing import ArrayLike

from datasets.core.errors import KoalaError

HOST, PORT = "127.0.0.1", 8080
"""Where pages are served: on this machine alone, at the first free port from there on."""
PATIENCE_S = 0.3
"""How long the end of a page waits for work that is under way."""
GLANCE_S = 0.2
"""Between two looks of the main thread, which alone handles signals, at whether one has come [s]."""
logger = logging.getLogger(__name__)


class _LocalServer(viser.ViserServer):
    """viser's server without its tunnel to the outside, which any browser that is connected could ask for."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Nothing is shared."""


@dataclass
class Page:
    """A page that is being served."""

    server: viser.ViserServer
    stopping: threading.Event = field(default_factory=threading.Event)
    """Set when the page ends: work in the background looks at it."""
    _workers: list[threading.Thread] = field(default_factory=list)

    @property
    def scene(self) -> viser.SceneApi:
        """What all browsers see in three dimensions."""
        return self.server.scene

    @property
    def gui(self) -> viser.GuiApi:
        """The panel at the side."""
        return self.server.gui

    @property
    def url(self) -> str:
        """What to open in the browser."""
        return f"http://{HOST}:{self.server.get_port()}"

    def look(self, position: ArrayLike, target: ArrayLike, *, up: ArrayLike = (0, 0, 1), size: float = 1.0) -> None:
        """Say where browsers look from when they open, and at what (3,) each [world unit].

        Args:
            up: (3,) direction that stays upright when the view is turned.
            size: of what is shown [world unit]; nearer than a hundredth of it, or further than a thousand times, is cut off.
        """
        self.scene.set_up_direction(tuple(map(float, up)))  # type: ignore[arg-type]
        camera = self.server.initial_camera
        camera.position, camera.look_at = (tuple(map(float, p)) for p in (position, target))  # type: ignore[misc, arg-type]
        camera.near, camera.far = 0.01 * size, 1e3 * size

    def in_background(self, work: Callable[[], None]) -> None:
        """Run `work` beside the page. It should look at `stopping` often; it is abandoned where it does not."""
        thread = threading.Thread(target=self._guarded, args=(work,), daemon=True)
        self._workers.append(thread)
        thread.start()

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except KoalaError as error:
            logger.warning("%s", error)
            self.say("Something went wrong", str(error))

    def say(self, title: str, words: str) -> None:
        """Show a note in every browser that is open."""
        for client in self.server.get_clients().values():
            client.add_notification(title, words)

    def wait(self) -> None:
        """Serve until Ctrl-C."""
        with contextlib.suppress(KeyboardInterrupt):
            while not self.stopping.wait(GLANCE_S):  # a signal that another thread was given does not wake this one
                continue

    def serve(self) -> NoReturn:
        """Serve until Ctrl-C, then end the process with exit code 0.

        At once, without taking the interpreter apart: a page writes nothing, and libraries for numerics alone need a second for it.
        """
        self.wait()
        self.close()
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(0)

    def close(self) -> None:
        """End the page; may be called twice."""
        self.stopping.set()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()
        for thread in self._workers:
            thread.join(PATIENCE_S / len(self._workers))


@contextlib.contextmanager
def open_page(title: str, port: int = PORT) -> Iterator[Page]:
    """Serve an empty page at `port` of 127.0.0.1, or the next one that is free, until the end of the `with` block.

    Args:
        title: shown above the panel.
        port: 1024 to 65535; 0 for any that is free.
    """
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # a browser that goes away is no news,
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection", category=UserWarning)  # nor is what it misses
    with contextlib.redirect_stdout(io.StringIO()):  # viser's banner; the command says where the page is
        server = _LocalServer(host=HOST, port=port, label=title, verbose=False)
    page = Page(server)
    try:
        server.gui.configure_theme(show_share_button=False, show_logo=False, control_width="large")
        server.gui.main_panel.dock_right()
        yield page
    finally:
        page.close()
