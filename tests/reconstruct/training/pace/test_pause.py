"""A training that gives way while somebody moves, and for no longer."""

import json
import os
from pathlib import Path

import pytest

from koala3d.reconstruct.training.pace import pause
from koala3d.reconstruct.training.pace.pause import AGAIN_S, HOLD_S, MOVING, NAP_S, PauseRequests, give_way, wanted_share
from tests.moments import Clock


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Of the page and of the training."""
    clock = Clock()
    monkeypatch.setattr(pause, "time", clock)
    return clock


def test_nobody_moves(tmp_path: Path) -> None:
    assert wanted_share(tmp_path) == 1.0 and give_way(tmp_path, 10.0) == 0.0


def test_while_somebody_moves_the_training_has_its_share(tmp_path: Path) -> None:
    """0.1 s of work at a quarter of the time: 0.3 s of rest, up to a nap more."""
    PauseRequests(tmp_path).request(0.25)
    assert wanted_share(tmp_path) == 0.25
    assert 0.3 <= give_way(tmp_path, 0.1) <= 0.3 + NAP_S


def test_a_pause_ends_after_the_last_move(tmp_path: Path) -> None:
    PauseRequests(tmp_path).request(0.0)
    assert HOLD_S <= give_way(tmp_path, 0.1) <= HOLD_S + NAP_S
    assert wanted_share(tmp_path) == 1.0


def test_ctrl_c_ends_a_pause(tmp_path: Path, clock: Clock) -> None:
    PauseRequests(tmp_path).request(0.0)
    assert 0.3 <= give_way(tmp_path, 0.1, until=lambda: clock.now >= 0.3) <= 0.3 + NAP_S < HOLD_S


def test_a_page_says_it_now_and_then_and_only_where_it_matters(tmp_path: Path, clock: Clock) -> None:
    requests = PauseRequests(tmp_path)
    requests.request(1.0)
    assert not (tmp_path / MOVING).exists(), "nothing is asked for"
    requests.request(0.5)
    written = os.stat(tmp_path / MOVING).st_mtime_ns
    clock.sleep(0.9 * AGAIN_S)
    requests.request(0.5)
    assert os.stat(tmp_path / MOVING).st_mtime_ns == written
    clock.sleep(0.1 * AGAIN_S)
    requests.request(0.5)
    assert json.loads((tmp_path / MOVING).read_text())["until"] == pytest.approx(AGAIN_S + HOLD_S)


@pytest.mark.parametrize(
    "content", ["", "no json", "[]", '{"share": "x", "until": 1}', '{"share": 0.0, "until": 1e18}', '{"share": 0.0}']
)
def test_a_strange_file_stops_no_training(tmp_path: Path, content: str) -> None:
    (tmp_path / MOVING).write_text(content)
    assert wanted_share(tmp_path) == 1.0
