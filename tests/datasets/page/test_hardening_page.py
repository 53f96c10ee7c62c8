"""A page answers those who opened it: requests of other sites are refused, and nothing but the page's own file is served."""

import socket
from collections.abc import Iterator, Sequence

import pytest
import viser

from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.page import open_page

UPGRADE = (
    ("Upgrade", "websocket"),
    ("Connection", "Upgrade"),
    ("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="),
    ("Sec-WebSocket-Version", "13"),
    ("Sec-WebSocket-Protocol", f"viser-v{viser.__version__}"),
)
"""What a browser sends to open a web socket (RFC 6455)."""
Headers = Sequence[tuple[str, str]]


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with open_page("guarded", 0) as page:
        yield page.server.get_port()


def ask(port: int, headers: Headers, path: str = "/") -> int:
    """Status of the answer to one request."""
    with socket.create_connection(("127.0.0.1", port), 20) as connection:
        lines = [f"GET {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers), "", ""]
        connection.sendall("\r\n".join(lines).encode())
        words = connection.recv(200).split()
    return int(words[1]) if len(words) > 1 else 0


def own(port: int) -> list[tuple[str, str]]:
    return [("Host", f"127.0.0.1:{port}")]


def test_the_page_and_its_web_socket_answer_who_opened_it(port: int) -> None:
    for host in (f"127.0.0.1:{port}", f"localhost:{port}", "localhost:9999"):  # the last: through `ssh -L 9999:127.0.0.1:PORT`
        assert ask(port, [("Host", host)]) == 200
        assert ask(port, [("Host", host), ("Origin", f"http://{host}"), *UPGRADE]) == 101


@pytest.mark.parametrize("more", [(), UPGRADE], ids=["page", "web socket"])
@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "192.168.0.7:8080", "localhost.evil.example:1", ""]
)
def test_a_request_with_a_foreign_host_is_refused(port: int, host: str, more: Headers) -> None:
    """DNS rebinding: a site's own name that leads to 127.0.0.1 makes the page part of that site."""
    assert ask(port, [("Host", host), *more]) in (400, 403, 421)


@pytest.mark.parametrize("more", [(), UPGRADE], ids=["page", "web socket"])
@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1.evil.example", "http://127.0.0.1:1", "file://"]
)
def test_a_request_of_a_foreign_origin_is_refused(port: int, origin: str, more: Headers) -> None:
    """Web sockets know no same-origin policy: any site that a person visits may open one to 127.0.0.1."""
    assert ask(port, [*own(port), ("Origin", origin), *more]) == 403


@pytest.mark.parametrize("headers", [[], [("Host", "127.0.0.1:1"), ("Host", "evil.example")]], ids=["none", "two"])
def test_a_request_without_one_host_is_refused(port: int, headers: Headers) -> None:
    assert ask(port, headers) in (400, 403)


@pytest.mark.parametrize(
    "path",
    [
        "/../_viser.py",
        "/..%2f..%2f_viser.py",
        "/%2e%2e/%2e%2e/_viser.py",
        "/..\\..\\_viser.py",
        "//etc/passwd",
        "/etc/passwd",
        "/.",
    ],
)
def test_nothing_but_the_pages_own_assets_is_served(port: int, path: str) -> None:
    assert ask(port, own(port), path) in ((200,) if path == "/." else (400, 403, 404))  # the dot is the page itself


def test_a_viewer_that_cannot_be_guarded_is_not_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    """As after an update of viser that takes the server from somewhere else."""
    from koala3d.datasets.page import server

    class Unguarded:
        def __init__(self, **options: object) -> None: ...

    monkeypatch.setattr(server, "_LocalServer", Unguarded)
    with pytest.raises(KoalaError, match="page cannot be guarded from other sites"), open_page("unguarded", 0):
        pass
