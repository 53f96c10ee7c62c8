"""A page in the browser, served on 127.0.0.1 only, complete in itself, and stopped by Ctrl-C within a second.

The browser loads one file with everything in it and then talks to this process through a web socket. Nothing is loaded from other
hosts, and other hosts cannot connect; requests of other sites' pages are refused. From another computer:
`ssh -L 8080:127.0.0.1:8080 HOST`.
"""

import contextlib
import http
import inspect
import io
import logging
import os
import re
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from email.message import Message
from typing import Any, NoReturn

import viser
import websockets.asyncio.server
from numpy.typing import ArrayLike
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from koala3d.datasets.core.errors import KoalaError

HOST, PORT = "127.0.0.1", 8080  # address of pages, for this machine only, at the first free port from PORT on
JOIN_S = 0.3  # how long closing a page waits for its background work [s]
POLL_S = 0.2  # interval at which the main thread, which alone handles signals, checks for one [s]
logger = logging.getLogger(__name__)


_opening = threading.Lock()


@contextlib.contextmanager
def _guarded_serving() -> Iterator[None]:
    """While this is open, the web servers that viser starts answer only requests that come from their own pages.

    Raises KoalaError: viser has started none in the way that is guarded.
    """
    serve, guards = websockets.asyncio.server.serve, 0

    def guarded(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        nonlocal guards
        guards += 1

        async def checked(connection: ServerConnection, request: Request) -> Response | None:
            if not from_own_page(request.headers):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "This page is for its own computer only.\n")
            answer = process_request(connection, request) if process_request is not None else None
            return await answer if inspect.isawaitable(answer) else answer

        return serve(*arguments, process_request=checked, **options)

    with _opening:
        websockets.asyncio.server.serve = guarded  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve  # type: ignore[misc]
    if not guards:
        why = f"viser {viser.__version__} starts its server in another way"
        remedy = "install another version: pip install 'viser>=1.1,<2'"
        raise KoalaError("page cannot be guarded from other sites", why=why, remedy=remedy)


def from_own_page(headers: Headers | Message) -> bool:
    """Whether a request names this computer as its host, once, and comes from no other site's page.

    A site may let its own name lead to 127.0.0.1 (DNS rebinding), and web sockets may be opened from any site's page.
    """
    hosts, origins = headers.get_all("Host") or [], headers.get_all("Origin") or []
    if len(hosts) != 1 or not re.fullmatch(r"(127\.0\.0\.1|localhost)(:[0-9]{1,5})?", hosts[0]):
        return False
    return all(origin == f"http://{hosts[0]}" for origin in origins)


class _LocalServer(viser.ViserServer):
    """viser's server without its public tunnel, which any connected browser could request."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing: pages are never shared."""


@dataclass
class Page:
    """A page that is being served."""

    server: viser.ViserServer
    stopping: threading.Event = field(default_factory=threading.Event)  # set when the page closes; background work checks it
    _workers: list[threading.Thread] = field(default_factory=list)

    @property
    def scene(self) -> viser.SceneApi:
        """The 3D scene of all browsers."""
        return self.server.scene

    @property
    def gui(self) -> viser.GuiApi:
        """The side panel."""
        return self.server.gui

    @property
    def url(self) -> str:
        """Address to open in the browser."""
        return f"http://{HOST}:{self.server.get_port()}"

    def look(self, position: ArrayLike, target: ArrayLike, *, up: ArrayLike = (0, 0, 1), size: float = 1.0) -> None:
        """Set the initial camera of browsers by its (3,) position and (3,) target [world unit].

        Args:
            up: (3,) direction that stays upright when the view is rotated.
            size: of the scene [world unit]; the clipping planes are at a hundredth and a thousand times of it.
        """
        self.scene.set_up_direction(tuple(map(float, up)))  # type: ignore[arg-type]
        camera = self.server.initial_camera
        camera.position, camera.look_at = (tuple(map(float, p)) for p in (position, target))  # type: ignore[misc, arg-type]
        camera.near, camera.far = 0.01 * size, 1e3 * size

    def in_background(self, work: Callable[[], None]) -> None:
        """Run `work` in a thread. It should check `stopping` often; otherwise it is abandoned at the end."""
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
        """Show a notification in every open browser."""
        for client in self.server.get_clients().values():
            client.add_notification(title, words)

    def wait(self) -> None:
        """Serve until Ctrl-C."""
        with contextlib.suppress(KeyboardInterrupt):
            while not self.stopping.wait(POLL_S):  # a signal delivered to another thread does not wake this one
                continue

    def serve(self) -> NoReturn:
        """Serve until Ctrl-C, then exit with code 0.

        The interpreter's shutdown is skipped: a page has nothing to write, and numerical libraries take a second to shut down.
        """
        self.wait()
        self.close()
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(0)

    def close(self) -> None:
        """Close the page; may be called twice."""
        self.stopping.set()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()
        for thread in self._workers:
            thread.join(JOIN_S / len(self._workers))


@contextlib.contextmanager
def open_page(title: str, port: int = PORT) -> Iterator[Page]:
    """Serve an empty page at `port` of 127.0.0.1, or the next free one, until the end of the `with` block.

    Args:
        title: shown above the panel.
        port: 1024 to 65535; 0 for any that is free.
    """
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # browsers may leave at any time
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection", category=UserWarning)
    with contextlib.redirect_stdout(io.StringIO()), _guarded_serving():  # viser's banner; commands print the address themselves
        server = _LocalServer(host=HOST, port=port, label=title, verbose=False)
    page = Page(server)
    try:
        server.gui.configure_theme(show_share_button=False, show_logo=False, control_width="large")
        server.gui.main_panel.dock_right()
        yield page
    finally:
        page.close()
