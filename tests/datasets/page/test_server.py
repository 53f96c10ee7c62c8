"""A page is served on this machine alone, shares nothing, and ends whatever goes on behind it."""

import signal
import socket
import threading
import time
import urllib.request

import pytest

from datasets.core.errors import UsageError
from datasets.page import open_page


def test_a_page_is_one_file_at_the_loopback_address_alone(capsys: pytest.CaptureFixture[str]) -> None:
    with open_page("empty", 0) as page:
        assert page.url.startswith("http://127.0.0.1:") and page.server.get_host() == "127.0.0.1"
        html = urllib.request.urlopen(page.url, timeout=30).read()
        assert b"<html" in html and b"https://" not in html
        port = page.server.get_port()
        others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {"127.0.0.1"}
        for address in others:
            with pytest.raises(OSError):
                socket.create_connection((address, port), timeout=2).close()
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", port), timeout=2).close()
    assert capsys.readouterr().out == ""  # what a command prints may be read by a program


def test_nobody_can_have_the_page_shared() -> None:
    with open_page("mine", 0) as page:
        assert page.server.request_share_url() is None
        assert page.server._share_tunnel is None


def test_a_port_that_is_taken_gives_way_to_the_next() -> None:
    with open_page("first", 0) as first:
        with open_page("second", first.server.get_port()) as second:
            assert second.server.get_port() > first.server.get_port()


def test_work_in_the_background_is_told_to_stop_and_never_waited_for_long() -> None:
    stopped, release = threading.Event(), threading.Event()
    with open_page("busy", 0) as page:

        def obedient() -> None:
            page.stopping.wait(60)
            stopped.set()

        page.in_background(obedient)
        page.in_background(lambda: release.wait(60))  # does not listen
        start = time.monotonic()
    assert stopped.wait(5) and time.monotonic() - start < 5  # 0.3 s on a computer that has time
    release.set()


def test_ctrl_c_ends_a_page_whichever_thread_the_system_tells_of_it() -> None:
    """Python handles signals in its main thread, which sleeps on where the system gave the signal to another one."""
    asleep, ended = threading.Event(), threading.Event()
    other = threading.Thread(target=lambda: (asleep.set(), ended.wait(60)), daemon=True)
    other.start()
    asleep.wait(20)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with open_page("waiting", 0) as page:
            timers = [
                threading.Timer(0.5, lambda: signal.pthread_kill(other.ident, signal.SIGINT)),
                threading.Timer(20, page.stopping.set),
            ]
            for timer in timers:
                timer.start()
            page.wait()
            assert not page.stopping.is_set(), "it was ended by the signal and not by the watch"
            timers[1].cancel()
    finally:
        signal.signal(signal.SIGINT, before)
        ended.set()


def test_an_error_in_the_background_is_said_and_does_not_end_the_page(caplog: pytest.LogCaptureFixture) -> None:
    def fails() -> None:
        raise UsageError("cannot be done", where="here")

    with open_page("failing", 0) as page:
        page.in_background(fails)
        deadline = time.monotonic() + 20
        while not caplog.records and time.monotonic() < deadline:
            time.sleep(0.05)
        assert urllib.request.urlopen(page.url, timeout=30).status == 200
    assert "here: cannot be done" in caplog.text
