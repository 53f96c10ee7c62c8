"""A page is served on this machine only, shares nothing, and closes whatever runs in the background."""

import signal
import socket
import sys
import threading
import traceback
import urllib.request

import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.page import Page, open_page
from tests.moments import as_soon_as, until


def test_a_page_is_one_file_at_the_loopback_address_only(capsys: pytest.CaptureFixture[str]) -> None:
    with open_page("empty", 0) as page:
        assert page.url.startswith("http://127.0.0.1:") and page.server.get_host() == "127.0.0.1"
        html = urllib.request.urlopen(page.url, timeout=30).read()
        assert b"<html" in html and b"https://" not in html
        port = page.server.get_port()
        others = {str(info[4][0]) for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {"127.0.0.1"}
        for address in others:
            with pytest.raises(OSError):
                socket.create_connection((address, port), timeout=2).close()
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", port), timeout=2).close()
    assert capsys.readouterr().out == ""  # what a command prints may be read by a program


def test_browsers_cannot_share_the_page() -> None:
    with open_page("mine", 0) as page:
        assert page.server.request_share_url() is None
        assert page.server._share_tunnel is None


def test_the_next_port_is_used_if_one_is_taken() -> None:
    with open_page("first", 0) as first:
        with open_page("second", first.server.get_port()) as second:
            assert second.server.get_port() > first.server.get_port()


def test_background_work_is_asked_to_stop_and_abandoned_otherwise() -> None:
    stopped, release, ignoring = threading.Event(), threading.Event(), threading.Event()

    def obedient() -> None:
        page.stopping.wait(60)
        stopped.set()

    def deaf() -> None:
        release.wait(60)
        ignoring.set()

    with open_page("busy", 0) as page:
        page.in_background(obedient)
        page.in_background(deaf)
    assert stopped.wait(5) and not ignoring.is_set(), "closing did not wait for the work that ignores it"
    release.set()


def test_ctrl_c_closes_a_page_whichever_thread_receives_the_signal() -> None:
    """Python handles signals in its main thread, which keeps sleeping if the system delivers the signal to another one."""
    closed = threading.Event()

    def receive() -> None:
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)
        if not closed.wait(20):
            page.stopping.set()  # the main thread would sleep for ever

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with open_page("waiting", 0) as page, as_soon_as(sleeps_in_wait, receive, "a main thread that sleeps"):
            page.wait()
            assert not page.stopping.is_set(), "it was closed by the signal, not by the limit"
            closed.set()
    finally:
        signal.signal(signal.SIGINT, before)


def sleeps_in_wait() -> bool:
    """Whether the main thread waits for an event in `Page.wait`."""
    main = sys._current_frames()[threading.main_thread().ident or 0]
    codes = [frame.f_code for frame, _ in traceback.walk_stack(main)]
    return codes[:3] == [function.__code__ for function in (threading.Condition.wait, threading.Event.wait, Page.wait)]


def test_an_error_in_the_background_is_logged_and_does_not_close_the_page(caplog: pytest.LogCaptureFixture) -> None:
    def fails() -> None:
        raise UsageError("cannot be done", where="here")

    with open_page("failing", 0) as page:
        page.in_background(fails)
        until(lambda: caplog.records, "the error in the log")
        assert urllib.request.urlopen(page.url, timeout=30).status == 200
    assert "here: cannot be done" in caplog.text
