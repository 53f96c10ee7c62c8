"""Whose picture comes next, and when one is given up; with browsers made up."""

import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from koala3d.reconstruct.page.render_loop import LEVELS, RenderLoop, viewpoint_of


class MadeUp:
    """A page and its browsers, as far as `RenderLoop` looks at them."""

    def __init__(self) -> None:
        self.stopping = threading.Event()
        self.server = SimpleNamespace(on_client_connect=self._on_connect, on_client_disconnect=self._on_disconnect)

    def _on_connect(self, callback: Callable[[Any], None]) -> None:
        self.connect = callback

    def _on_disconnect(self, callback: Callable[[Any], None]) -> None:
        self.disconnect = callback

    def browser(self, number: int) -> Any:
        moves: list[Callable[[Any], None]] = []
        camera = SimpleNamespace(wxyz=(1.0, 0, 0, 0), position=(0.0, 0, 0), fov=0.7, image_width=300, image_height=200,
                                 on_update=moves.append)  # fmt: skip
        client = SimpleNamespace(client_id=number, camera=camera, move=lambda: [callback(camera) for callback in moves])
        self.connect(client)
        return client


class Painter:
    """Notes what is asked for; a picture takes until it is let through."""

    def __init__(self) -> None:
        self.shown: list[tuple[int, int]] = []
        self.given_up: list[tuple[int, int]] = []
        self.begun = threading.Semaphore(0)
        self.through = threading.Semaphore(0)
        self.at_once = True

    def __call__(self, client: Any, viewpoint: Any, rays: int, cancelled: Callable[[], bool]) -> None:
        self.begun.release()
        while not self.at_once and not self.through.acquire(timeout=0.01):
            if cancelled():
                break
        (self.given_up if cancelled() else self.shown).append((client.client_id, rays))


class Resting(threading.Condition):
    """Notes that the loop waits, which it does when nothing is left to render."""

    def __init__(self) -> None:
        super().__init__()
        self.begun = threading.Event()

    def wait(self, timeout: float | None = None) -> bool:
        self.begun.set()
        return super().wait(timeout)


@pytest.fixture
def made() -> Any:
    page, painter = MadeUp(), Painter()
    loop = RenderLoop(page, painter)
    loop._changed = Resting()
    thread = threading.Thread(target=loop.run, daemon=True)
    yield page, painter, loop, thread
    page.stopping.set()
    if thread.is_alive():
        thread.join(10)
    assert not thread.is_alive()


def wait_for(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < deadline, "never came"
        time.sleep(0.01)


def test_pictures_get_finer_up_to_the_level_that_is_wanted(made: Any) -> None:
    page, painter, loop, thread = made
    loop.levels = 3
    page.browser(7)
    thread.start()
    assert loop._changed.begun.wait(20)
    assert painter.shown == [(7, rays) for rays in LEVELS[:3]]


def test_who_moves_gets_a_coarse_picture_first_and_the_fine_one_is_given_up(made: Any) -> None:
    page, painter, loop, thread = made
    client = page.browser(1)
    painter.at_once = False
    thread.start()
    painter.through.release()
    wait_for(lambda: painter.shown == [(1, LEVELS[0])])
    painter.begun.acquire(timeout=20)
    painter.begun.acquire(timeout=20)  # the second level has begun
    client.move()
    wait_for(lambda: painter.given_up == [(1, LEVELS[1])])
    painter.at_once = True
    wait_for(lambda: len(painter.shown) == 1 + loop.levels)
    assert painter.shown[1:] == [(1, rays) for rays in LEVELS[: loop.levels]]


def test_the_coarsest_picture_is_finished_even_while_somebody_moves(made: Any) -> None:
    page, painter, _, thread = made
    client = page.browser(1)
    painter.at_once = False
    thread.start()
    assert painter.begun.acquire(timeout=20)
    client.move()
    painter.through.release()
    wait_for(lambda: painter.shown == [(1, LEVELS[0])])
    assert painter.given_up == []


def test_two_browsers_both_get_a_coarse_picture_before_either_gets_a_fine_one(made: Any) -> None:
    page, painter, loop, thread = made
    loop.levels = 2
    page.browser(1), page.browser(2)
    thread.start()
    wait_for(lambda: len(painter.shown) == 4)
    assert {rays for _, rays in painter.shown[:2]} == {LEVELS[0]} and {key for key, _ in painter.shown[:2]} == {1, 2}


def test_a_browser_that_goes_away_while_its_picture_is_made_holds_nobody_up(made: Any) -> None:
    page, painter, loop, thread = made
    loop.levels = 1
    leaving = page.browser(1)
    painter.at_once = False
    thread.start()
    assert painter.begun.acquire(timeout=20)
    page.disconnect(leaving)
    wait_for(lambda: painter.given_up == [(1, LEVELS[0])])
    painter.at_once = True
    page.browser(2)
    wait_for(lambda: painter.shown == [(2, LEVELS[0])])


def test_a_new_model_is_shown_to_all(made: Any) -> None:
    page, painter, loop, thread = made
    loop.levels = 1
    page.browser(1), page.browser(2)
    thread.start()
    wait_for(lambda: len(painter.shown) == 2)
    loop.restart()
    wait_for(lambda: len(painter.shown) == 4)
    assert sorted(painter.shown) == [(1, LEVELS[0])] * 2 + [(2, LEVELS[0])] * 2


def test_no_level_no_pictures(made: Any) -> None:
    page, painter, loop, thread = made
    loop.levels = 0
    page.browser(1)
    thread.start()
    assert loop._changed.begun.wait(20)
    assert painter.shown == []


def test_an_eye_is_where_the_browser_is() -> None:
    half = np.sqrt(0.5)
    camera = SimpleNamespace(wxyz=(half, half, 0, 0), position=(1.0, 2, 3), fov=0.7, image_width=300, image_height=200)
    found = viewpoint_of(SimpleNamespace(camera=camera))
    assert np.allclose(found.world_from_camera[:3, 3], [1, 2, 3]) and np.allclose(found.world_from_camera[:3, 2], [0, -1, 0])
    assert found.fov == 0.7 and found.aspect == 1.5
