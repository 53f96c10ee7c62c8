"""What the four commands share: progress, one line per error, exit codes 0, 1 and 2. Shared options are in `options`.

0: done. 1: failed. 2: invalid request. `--debug` shows the traceback.
"""

import errno
import json
import logging
import os
import shlex
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.core.extras import not_installed
from koala3d.datasets.core.help import CHECK as CHECK
from koala3d.datasets.core.help import LOOK as LOOK
from koala3d.datasets.core.help import MAIN as MAIN
from koala3d.datasets.core.help import STUDY as STUDY
from koala3d.datasets.core.help import WIDE, App, Group
from koala3d.datasets.core.options import Json as Json
from koala3d.datasets.core.options import Port as Port

_INTERRUPTED = 130  # what newer versions of typer return where Ctrl-C stopped a command
_ClickException: Any = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")
"""Base of typer's errors about arguments: from click, or from the copy of click in newer versions of typer."""
_state = {"debug": False, "json": False}


def make_app(name: str, help: str) -> App:
    """A command with Koala's conventions; add subcommands with `@app.command(panel=MAIN)`, run with `run(app)`."""
    settings = {"help_option_names": ["-h", "--help"], "max_content_width": WIDE}
    app = App(
        name=name,
        cls=Group,
        help=help,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings=settings,
        rich_markup_mode=None,
    )

    @app.callback(help=help)
    def _common(debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks and debug messages.")] = False) -> None:
        _state["debug"] = debug
        logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
        logging.getLogger("koala3d").setLevel(logging.DEBUG if debug else logging.WARNING)  # others log thousands of messages

    return app


def run(app: typer.Typer) -> None:
    """Run a command line: every failure becomes one line on stderr and exit code 1 or 2.

    Ctrl-C stops it, also if a shell has started it with `&` in a script: the interpreter then ignores the signal.
    """
    if threading.current_thread() is threading.main_thread():  # others may set no handlers
        signal.signal(signal.SIGINT, signal.default_int_handler)
    _state.update(debug="--debug" in sys.argv, json="--json" in sys.argv)
    try:
        result = app(standalone_mode=False)
        if result == _INTERRUPTED:
            raise KeyboardInterrupt
    except typer.Exit as stop:
        sys.exit(stop.exit_code)
    except _ClickException as error:
        _misused(error)
    except (KeyboardInterrupt, typer.Abort):
        _fail("stopped by Ctrl-C; what was finished is kept", 1)
    except KoalaError as error:
        _fail(str(error), error.exit_code, error)
    except OSError as error:
        _fail(_os_error(error), 1, error)
    except ModuleNotFoundError as error:
        missing = not_installed(error)
        _fail(str(missing) if missing else f"{error}; run again with --debug and report it", 1, error)
    except Exception as error:  # a bug: one line, and the traceback with --debug
        _fail(f"unexpected {type(error).__name__}: {error}; run again with --debug and report it", 1, error)
    sys.exit(result if isinstance(result, int) else 0)


def _misused(error: Any) -> NoReturn:
    """Say in one line what is wrong with the arguments, and what would be right; without arguments, print the help."""
    kind, context = type(error).__name__, getattr(error, "ctx", None)
    if kind == "NoArgsIsHelpError":
        print(context.get_help() if context else "", file=sys.stderr, flush=True)
        sys.exit(2)
    message = error.format_message().strip().rstrip(".")
    if kind == "NoSuchOption":
        close = [name for name in error.possibilities or () if name.startswith("--")]
        message = f"there is no option '{error.option_name}'" + (f"; did you mean '{close[0]}'?" if close else "")
    advice = f"; '{context.command_path} --help' shows its arguments" if context is not None and "mean" not in message else ""
    _fail(message + advice, 2)


def _os_error(error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{error.filename or 'output'}: the disk is full; free some space and run again; no half-written file is left"
    return f"{error.filename or ''}: {error.strerror or error}".lstrip(": ")


def _fail(message: str, code: int, error: BaseException | None = None) -> NoReturn:
    if _state["debug"] and error is not None:
        import traceback

        traceback.print_exception(error)
    line = " ".join(message.split())
    if _state["json"]:
        print(json.dumps({"error": line, "exit_code": code}), flush=True)
    print(f"error: {line}", file=sys.stderr, flush=True)
    sys.exit(code)


def report(result: dict[str, Any], *, as_json: bool, text: str) -> None:
    """Print the result of a command: `text` for a person, `result` for a program."""
    from koala3d.datasets.core.files import plain

    print(json.dumps(result, default=plain) if as_json else text, flush=True)


def line(text: str) -> None:
    """Write one line for another program to the standard output; `text` ends with a newline."""
    print(text, end="", flush=True)


def command_line() -> str:
    """The running command, ready to be typed again."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def hint(words: str) -> None:
    """Show a person one line on stderr while a command runs."""
    print(words, file=sys.stderr, flush=True)


class Progress:
    """Progress of one long task; `advance` moves it, `note` shows a few words beside it."""

    def __init__(self, title: str, total: float, unit: str) -> None:
        self.title, self.total, self.unit = title, total, unit
        self.done, self.words, self.start = 0.0, "", time.monotonic()
        self._printed = self.start

    def advance(self, amount: float = 1.0) -> None:
        """Count `amount` more units as done."""
        self.done += amount
        self._changed()

    def show(self, finished: int, total: int) -> None:
        """Set the number of units done and their total: a `datasets.core.progress.Count`."""
        self.total = total
        self.advance(finished - self.done)

    def note(self, words: str) -> None:
        """Show `words` (a loss, a frame's name) beside the bar."""
        self.words = words
        self._changed()

    def _changed(self) -> None:
        now = time.monotonic()
        if now - self._printed >= 5:
            self._printed = now
            print(self.line(), file=sys.stderr, flush=True)

    def line(self) -> str:
        """One plain line: share done, rate, remaining time."""
        elapsed = time.monotonic() - self.start
        rate = self.done / elapsed if elapsed > 0 else 0.0
        left = f", {max(self.total - self.done, 0) / rate:.0f} s left" if rate > 0 else ""
        return f"{self.title}: {self.done:.0f}/{self.total:.0f} {self.unit}{left}{'  ' + self.words if self.words else ''}"


class _BarProgress(Progress):
    """The same on a terminal, drawn by rich."""

    def __init__(self, title: str, total: float, unit: str) -> None:
        super().__init__(title, total, unit)
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        counted = TextColumn("{task.completed:.0f}/{task.total:.0f} " + unit)
        columns = TextColumn("{task.description}"), BarColumn(), counted, TimeElapsedColumn(), TimeRemainingColumn()
        self.bar = Bar(*columns, TextColumn("{task.fields[words]}"), console=Console(stderr=True), transient=True)
        self.task = self.bar.add_task(title, total=total, words="")

    def _changed(self) -> None:
        self.bar.update(self.task, completed=self.done, words=self.words)


@contextmanager
def progress(title: str, total: float, unit: str = "") -> Iterator[Progress]:
    """A progress bar on a terminal; elsewhere a plain line every five seconds, on stderr."""
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        yield Progress(title, total, unit)
        return
    shown = _BarProgress(title, total, unit)
    with shown.bar:
        yield shown
