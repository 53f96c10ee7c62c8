"""How `docs/measure_pages.py` answers a wrong request. The measurement itself needs an idle computer and is not tested."""

import runpy
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[2] / "docs" / "measure_pages.py"


@pytest.fixture(autouse=True)
def neighbours_can_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    """As when Python runs the program."""
    monkeypatch.syspath_prepend(PROGRAM.parent)


def answered(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    """Exit code and what is said on stderr."""
    monkeypatch.setattr(sys, "argv", [str(PROGRAM), *map(str, words)])
    code = 0
    try:
        runpy.run_path(str(PROGRAM), run_name="__main__")
    except SystemExit as left:
        code = int(left.code or 0)
    out, text = capsys.readouterr()
    assert not out
    return code, text


def test_it_explains_itself(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    code, text = answered(monkeypatch, capsys, "--help")
    assert code == 0 and "training SCENE [SECONDS] [alone] [open] [moving]" in text


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (("training",), "one of moving, memory, training"),
        (("training", ".", 20, "alone", "opne"), "did you mean 'open'?"),
        (("memory", "nowhere", 3), "no such run or scene"),
        (("moving", ".", "fast"), "give seconds alone"),
    ],
)
def test_a_wrong_request_is_answered_in_one_line(
    words: tuple[object, ...], answer: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, text = answered(monkeypatch, capsys, *words)
    assert code == 2 and answer in text and len(text.splitlines()) == 1
