"""Windows of a headless Chromium for the tests of pages.

    with browse(page) as window:
        window.page.get_by_text("stop the arm").click()

The block fails if the page threw an error, logged one, or asked for anything that is not its own, so that no test has to look.
"""

import asyncio
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

if TYPE_CHECKING:
    from koala3d.datasets.page import Page

NAMES = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    "--no-sandbox",  # root has none
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # WebGL on the processor
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",  # no other host is ever reached
)
PATIENCE_S = 120.0
"""Pages are drawn without a graphics card, on a computer that may be busy."""
WIDTH, HEIGHT, PANEL = 1000, 560, 400
"""Size of a window, and width of the panel at its right [px]."""


class Browsed:
    """A window on a page, and what is wrong with the page; faults that match the pattern `expected` may be."""

    def __init__(self, page: Any, url: str, expected: str | None) -> None:
        self.page, self.url, self.expected = page, url, expected
        self.faults: list[str] = []
        page.on("pageerror", lambda error: self._wrong(f"threw {error}"))
        page.on("console", self._logged)
        page.on("request", lambda request: self._asked(request.url))
        page.on("websocket", lambda socket: self._asked(socket.url))
        page.goto(url)
        page.add_style_tag(content=".mantine-Notifications-root { display: none }")  # a warning about the missing graphics card

    def _logged(self, message: Any) -> None:
        # a page may replace its own pictures (blob:) while the browser still loads them
        if message.type == "error" and not message.location.get("url", "").startswith("blob:"):
            self._wrong(f"logged {message.text}")

    def _asked(self, url: str) -> None:
        if not url.startswith("data:") and place(url) != place(self.url):
            self._wrong(f"asked for {url}")

    def _wrong(self, fault: str) -> None:
        if self.expected is None or not re.search(self.expected, fault):
            self.faults.append(fault)

    def check(self) -> None:
        """Raise AssertionError for what is wrong so far."""
        self.page.evaluate("new Promise(done => setTimeout(done))")  # what was logged before has arrived afterwards
        assert not self.faults, f"{self.url} {'; '.join(self.faults)}"

    def choose(self, label: str, option: str) -> None:
        """Choose an option of a list in the panel."""
        self.page.get_by_label(label, exact=True).first.click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def click_scene(self) -> None:
        """Click in the middle of the scene."""
        self.page.mouse.click((WIDTH - PANEL) / 2, HEIGHT / 2)

    def picture(self) -> np.ndarray:
        """(height, width, 3) sRGB bytes of the window without the panel."""
        png = self.page.screenshot(clip={"x": 0, "y": 0, "width": WIDTH - PANEL, "height": HEIGHT})
        pixels = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
        assert pixels is not None
        return pixels[..., ::-1]

    def until(self, holds: Callable[[np.ndarray], Any], what: str) -> np.ndarray:
        """The first picture that satisfies `holds`; an AssertionError that names `what` if none does in time."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            self.check()
            picture = self.picture()
            if holds(picture):
                return picture
            self.page.wait_for_timeout(300)
        raise AssertionError(f"did not appear: {what}")


Browse = Callable[..., AbstractContextManager[Browsed]]


def light_plainly(page: "Page") -> None:
    """Replace the reflections of a city, which take a processor five seconds in each window, and the shadows by a plain light."""
    page.scene.configure_environment_map(None)
    page.scene.configure_default_lights(cast_shadow=False)
    page.scene.add_light_hemisphere("/light")


def place(url: str) -> str:
    """Host and port that answer a URL; of a file, its path."""
    parts = urlsplit(url.removeprefix("blob:"))
    return parts.netloc or parts.path


class Chromium:
    """A browser whose event loop is the thread's running one only while a window is open: tests may run others in between."""

    def __init__(self, browser: Any, loop: asyncio.AbstractEventLoop) -> None:
        self.browser, self.loop = browser, loop

    @contextmanager
    def resumed(self) -> Iterator[Any]:
        """The browser, ready for calls."""
        before = asyncio._get_running_loop()
        asyncio._set_running_loop(self.loop)
        try:
            yield self.browser
        finally:
            asyncio._set_running_loop(before)


@pytest.fixture(scope="session")
def chromium() -> Iterator[Chromium]:
    """The one Chromium of this process; skips the test if none is installed."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is absent: pip install '.[test]'")
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        pytest.skip("there is no Chromium on this computer: make tools")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=ARGUMENTS, timeout=1e3 * PATIENCE_S)
        loop = asyncio.get_running_loop()
        asyncio._set_running_loop(None)
        yield Chromium(browser, loop)
        asyncio._set_running_loop(loop)
        browser.close()


@pytest.fixture
def browse(chromium: Chromium) -> Browse:
    """Opens a window on a page, or on the URL of a file or of another process; fails the test if what it shows is not sound."""

    @contextmanager
    def opened(shown: "Page | str", *, expected: str | None = None) -> Iterator[Browsed]:
        if not isinstance(shown, str):
            light_plainly(shown)
        url, size = shown if isinstance(shown, str) else shown.url, {"width": WIDTH, "height": HEIGHT}
        with chromium.resumed() as browser, browser.new_context(viewport=size) as context:
            context.set_default_timeout(1e3 * PATIENCE_S)
            window = Browsed(context.new_page(), url, expected)
            window.check()
            try:
                yield window
            except BaseException as error:
                error.add_note(f"{url} {'; '.join(window.faults) or 'is sound'}")
                raise
            window.check()

    return opened
