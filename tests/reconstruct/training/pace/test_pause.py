"""A training that gives way while somebody moves, and for no longer."""

import os
import threading
import time
from pathlib import Path

import pytest

from reconstruct.training.pace import pause
from reconstruct.training.pace.pause import MOVING, PauseRequests, give_way, wanted_share


def test_nobody_moves(tmp_path: Path) -> None:
    assert wanted_share(tmp_path) == 1.0 and give_way(tmp_path, 10.0) < 0.05


def test_while_somebody_moves_the_training_has_its_share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """0.1 s of work at a quarter of the time: 0.3 s of rest, up to a nap more; the hold is long enough for a busy computer."""
    monkeypatch.setattr(pause, "HOLD_S", 60.0)
    PauseRequests(tmp_path).request(0.25)
    assert wanted_share(tmp_path) == 0.25
    rest = give_way(tmp_path, 0.1)
    assert rest >= 0.3 and rest < 0.3 + 5.0


def test_a_pause_ends_after_the_last_move(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pause, "HOLD_S", 0.5)
    PauseRequests(tmp_path).request(0.0)
    begun = time.monotonic()
    assert give_way(tmp_path, 0.1) > 0.2  # the file is written 0.5 s ahead; some of it may be over already
    assert time.monotonic() - begun < 10 and wanted_share(tmp_path) == 1.0


def test_ctrl_c_ends_a_pause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pause, "HOLD_S", 600.0)
    PauseRequests(tmp_path).request(0.0)
    came = threading.Event()
    threading.Timer(0.3, came.set).start()
    assert give_way(tmp_path, 0.1, until=came.is_set) < 60


def test_a_page_says_it_now_and_then_and_only_where_it_matters(tmp_path: Path) -> None:
    requests = PauseRequests(tmp_path)
    requests.request(1.0)
    assert not (tmp_path / MOVING).exists(), "nothing is asked for"
    requests.request(0.5)
    written = os.stat(tmp_path / MOVING).st_mtime_ns
    requests.request(0.5)
    assert os.stat(tmp_path / MOVING).st_mtime_ns == written


@pytest.mark.parametrize(
    "content", ["", "no json", "[]", '{"share": "x", "until": 1}', '{"share": 0.0, "until": 1e18}', '{"share": 0.0}']
)
def test_a_strange_file_stops_no_training(tmp_path: Path, content: str) -> None:
    (tmp_path / MOVING).write_text(content)
    assert wanted_share(tmp_path) == 1.0
