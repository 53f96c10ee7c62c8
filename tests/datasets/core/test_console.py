"""What every command does with results, progress and errors."""

import errno
import json
import os
import subprocess
import sys
from typing import Annotated

import pytest
import typer

from koala3d.datasets.core import console
from koala3d.datasets.core.errors import KoalaError, UsageError, nearest


def outcome(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: BaseException | None, *options: str
) -> tuple:
    """(exit code, stdout, stderr) of a command that raises `error`."""
    app = console.make_app("made-up", "A command for a test.")

    @app.command()
    def work(as_json: console.Json = False, count: Annotated[int, typer.Option()] = 1) -> None:
        """Work."""
        if error is not None:
            raise error
        console.report({"count": count}, as_json=as_json, text=f"count {count}")

    @app.command()
    def rest() -> int:
        """Rest."""
        return 1

    monkeypatch.setattr(sys, "argv", ["made-up", *options])
    with pytest.raises(SystemExit) as stopped:
        console.run(app)
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (KoalaError("broke", where="here", why="so", remedy="mend it"), 1, "error: here: broke (so); mend it\n"),
        (UsageError("is no number"), 2, "error: is no number\n"),
        (KeyboardInterrupt(), 1, "error: stopped by Ctrl-C"),
        (OSError(errno.ENOSPC, "No space left on device", "out/a.png"), 1, "error: out/a.png: the disk is full"),
        (PermissionError(errno.EACCES, "Permission denied", "out"), 1, "error: out: Permission denied\n"),
        (ZeroDivisionError("two\nlines"), 1, "error: unexpected ZeroDivisionError: two lines; run again with --debug"),
    ],
)
def test_every_error_is_one_line(monkeypatch, capsys, error: BaseException, code: int, words: str) -> None:
    stopped, out, err = outcome(monkeypatch, capsys, error, "work")
    assert stopped == code and err.startswith(words) and err.count("\n") == 1 and out == ""
    stopped, out, _ = outcome(monkeypatch, capsys, error, "work", "--json")
    assert stopped == code and json.loads(out)["exit_code"] == code


def test_results_as_text_and_json(monkeypatch, capsys) -> None:
    assert outcome(monkeypatch, capsys, None, "work", "--count", "3") == (0, "count 3\n", "")
    assert outcome(monkeypatch, capsys, None, "work", "--json") == (0, '{"count": 1}\n', "")
    assert outcome(monkeypatch, capsys, None, "rest")[0] == 1


@pytest.mark.parametrize("options", [("wrk",), ("work", "--cont", "3"), ("work", "--count", "many"), ("work", "extra")])
def test_wrong_arguments_are_usage_errors(monkeypatch, capsys, options: tuple[str, ...]) -> None:
    code, _, err = outcome(monkeypatch, capsys, None, *options)
    assert code == 2 and err.startswith("error: ") and err.count("\n") == 1


@pytest.mark.parametrize(("options", "words"), [
    (("wrk",), "'work'?"), (("work", "--cont", "3"), "there is no option '--cont'; did you mean '--count'?"),
    (("work", "extra"), "work --help' shows its arguments"), (("--dbug", "work"), "did you mean '--debug'?"),
])  # fmt: skip
def test_wrong_names_suggest_the_nearest(monkeypatch, capsys, options: tuple[str, ...], words: str) -> None:
    assert words in outcome(monkeypatch, capsys, None, *options)[2]


def test_without_a_command_help_is_printed(monkeypatch, capsys) -> None:
    code, out, err = outcome(monkeypatch, capsys, None)
    assert code == 2 and out == "" and "error" not in err and "work" in err and err.count("\n") > 5


@pytest.mark.parametrize(("typed", "offered"), [
    ("datasets tr", "truth"), ("datasets export x --for", "--format"), ("datasets export x --format ner", "nerfstudio"),
])  # fmt: skip
def test_the_shell_completes_names(typed: str, offered: str) -> None:
    """As bash asks for it, after `datasets --install-completion`."""
    words = typed.split(" ")
    asked = {"_DATASETS_COMPLETE": "complete_bash", "COMP_WORDS": "\n".join(words), "COMP_CWORD": str(len(words) - 1)}
    code = "import sys; sys.argv = ['datasets']; from koala3d.datasets.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code], env={**os.environ, **asked}, capture_output=True, text=True, timeout=60)
    assert offered in done.stdout.split(), done.stderr


def test_progress_without_a_terminal_is_plain_lines(monkeypatch, capsys) -> None:
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.progress("reading", 10, "images") as shown:
        for _ in range(10):
            now[0] += 1.0
            shown.advance()
    assert capsys.readouterr().err.splitlines() == ["reading: 5/10 images, 5 s left", "reading: 10/10 images, 0 s left"]


def test_nearest_spelling_or_all_names() -> None:
    assert nearest("blendr", {"blender", "llff"}) == "did you mean 'blender'?"
    assert nearest("xyz", {"b", "a"}) == "valid: a, b"
