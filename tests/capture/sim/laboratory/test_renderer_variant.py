import logging
import subprocess
from collections.abc import Iterator

import pytest

from capture.sim.laboratory.renderer_variant import FAST, SURE, variant


@pytest.fixture(autouse=True)
def forgotten(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What an earlier trial has shown is not remembered, nor what this one does."""
    monkeypatch.delenv("KOALA_RENDERER", raising=False)
    variant.cache_clear()
    yield
    variant.cache_clear()


def trial_ends(monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    monkeypatch.setattr(subprocess, "run", lambda *a, **k: subprocess.CompletedProcess([], returncode=code))


def test_can_be_asked_for(monkeypatch, caplog):
    monkeypatch.setenv("KOALA_RENDERER", SURE)
    trial_ends(monkeypatch, 0)
    assert variant() == SURE and not caplog.records  # who asks for it is not warned


def test_falls_back_where_the_trial_dies_and_says_so(monkeypatch, caplog):
    trial_ends(monkeypatch, -6)
    with caplog.at_level(logging.WARNING):
        assert variant() == SURE
    assert "libllvm19" in caplog.text


def test_falls_back_where_the_trial_hangs(monkeypatch):
    def hang(*arguments: object, **options: object) -> None:
        raise subprocess.TimeoutExpired("trial", 60)

    monkeypatch.setattr(subprocess, "run", hang)
    assert variant() == SURE


def test_is_fast_where_the_trial_survives(monkeypatch):
    trial_ends(monkeypatch, 0)
    assert variant() == FAST
