"""The folder of a series in the browser of this computer: its page, loaded anew when it changes, and what it links to."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.page.server import HOST, from_own_page

INDEX = "index.html"
PORTS = 20
"""Ports that are tried, from the given one on."""
RELOADED = b"""<script>
let before;
setInterval(async () => {
  const now = (await fetch("/", {method: "HEAD"})).headers.get("Last-Modified");
  if (before && now && now !== before) location.reload();
  before = now;
}, 2000);
</script>
"""


class _Handler(SimpleHTTPRequestHandler):
    """Answers requests of this computer's own pages with files of one folder."""

    def do_GET(self) -> None:
        """Send a file; the page of the series with a script that looks whether it has changed."""
        if not self._allowed():
            return
        if self.path not in ("/", f"/{INDEX}"):
            return super().do_GET()
        page = Path(self.directory, INDEX)
        content = page.read_bytes() + RELOADED
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def do_HEAD(self) -> None:
        """Say when a file was written."""
        if self._allowed():
            super().do_HEAD()

    def end_headers(self) -> None:
        """No file is kept by the browser."""
        self.send_header("Cache-Control", "no-store")
        super().end_headers()

    def list_directory(self, path: Any) -> None:
        """Refuse: a folder without a page has nothing to show."""
        self.send_error(HTTPStatus.NOT_FOUND)

    def log_message(self, format: str, *words: Any) -> None:
        """Print nothing."""

    def _allowed(self) -> bool:
        """Whether the request may be answered; if not, say so. Links do not lead out of the folder."""
        root, asked = Path(self.directory).resolve(), Path(self.translate_path(self.path)).resolve()
        if not from_own_page(self.headers):
            self.send_error(HTTPStatus.FORBIDDEN, "This page is for its own computer only.")
        elif not asked.is_relative_to(root):
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            return True
        return False


@contextmanager
def served(folder: Path, port: int) -> Iterator[str]:
    """Serve the folder of a series at the first free port from `port` on; yields the address. Raises UsageError: none is free."""
    handler = partial(_Handler, directory=str(folder))
    for number in range(port, port + PORTS):
        try:
            server = ThreadingHTTPServer((HOST, number), handler)
        except OSError:
            continue
        with server:
            Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True).start()
            try:
                yield f"http://{HOST}:{server.server_port}"
            finally:
                server.shutdown()
        return
    raise UsageError(f"no port from {port} to {port + PORTS - 1} is free", where="--port", remedy="choose another --port")
