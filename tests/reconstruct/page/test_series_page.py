"""The page of a series in the browser: it follows the file, and nothing else of the computer can be read."""

import os
import socket
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlparse

import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.page import series_page


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    series = tmp_path / "series"
    (series / "cup" / "report").mkdir(parents=True)
    (series / "index.html").write_text("<h1>one</h1>")
    (series / "cup" / "report" / "index.html").write_text("the report")
    (tmp_path / "secret.txt").write_text("secret")
    (series / "link.txt").symlink_to(tmp_path / "secret.txt")
    return series


def asked(url: str, path: str, method: str = "GET", **headers: str) -> tuple[int, str, dict[str, str]]:
    """Status, content and headers of an answer."""
    connection = HTTPConnection(urlparse(url).netloc)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    content = answer.read().decode()
    connection.close()
    return answer.status, content, dict(answer.headers)


def test_the_page_follows_the_file(folder: Path) -> None:
    with series_page.served(folder, 8090) as url:
        status, content, headers = asked(url, "/")
        assert status == 200 and content.startswith("<h1>one</h1>") and "location.reload" in content
        assert headers["Cache-Control"] == "no-store"
        before = asked(url, "/", "HEAD")[2]["Last-Modified"]
        (folder / "index.html").write_text("<h1>two</h1>")
        os.utime(folder / "index.html", (2e9, 2e9))
        assert asked(url, "/")[1].startswith("<h1>two</h1>")
        assert asked(url, "/", "HEAD")[2]["Last-Modified"] != before
        assert asked(url, "/cup/report/index.html")[:2] == (200, "the report")


@pytest.mark.parametrize("path", ["/../secret.txt", "/link.txt", "/%2e%2e/secret.txt", "/cup/"])
def test_nothing_else_is_shown(folder: Path, path: str) -> None:
    with series_page.served(folder, 8090) as url:
        status, content, _ = asked(url, path)
    assert status == 404 and "secret" not in content


def test_other_sites_get_nothing(folder: Path) -> None:
    with series_page.served(folder, 8090) as url:
        for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}):
            assert asked(url, "/", **headers)[0] == 403


def test_the_next_free_port_is_taken_and_none_is_said(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        series_page.served(folder, 8090) as first,
        series_page.served(folder, 8090) as second,
        socket.create_server(("127.0.0.1", 0)) as taken,
    ):
        assert first != second
        monkeypatch.setattr(series_page, "PORTS", 1)
        with (
            pytest.raises(UsageError, match=r"no port from \d+ to \d+ is free"),
            series_page.served(folder, taken.getsockname()[1]),
        ):
            pass
