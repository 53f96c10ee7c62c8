"""How `docs/measure_pages.py` answers a wrong request. The measurement itself needs an idle computer and is not tested."""

import subprocess
import sys
from pathlib import Path

PROGRAM = Path(__file__).parents[2] / "docs" / "measure_pages.py"


def answered(*words: object) -> tuple[int, str]:
    done = subprocess.run([sys.executable, str(PROGRAM), *map(str, words)], capture_output=True, text=True, timeout=120)
    assert not done.stdout and "Traceback" not in done.stderr
    return done.returncode, done.stderr


def test_it_explains_itself() -> None:
    code, text = answered("--help")
    assert code == 0 and "training SCENE [SECONDS] [alone] [open] [moving]" in text


def test_a_wrong_request_is_answered_in_one_line() -> None:
    wrong: dict[tuple[object, ...], str] = {
        ("training",): "one of moving, memory, training",
        ("training", ".", 20, "alone", "opne"): "did you mean 'open'?",
        ("memory", "nowhere", 3): "no such run or scene",
        ("moving", ".", "fast"): "give seconds alone",
    }
    for words, answer in wrong.items():
        code, text = answered(*words)
        assert code == 2 and answer in text and len(text.splitlines()) == 1, words
