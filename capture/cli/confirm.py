"""Asks on the terminal before each move of the arm."""

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from koala3d.datasets.core import console

if TYPE_CHECKING:
    from koala3d.capture.rig.moves import NextMove

QUESTION = "move? y: yes; all: this one and all others; stop: end here"


def asker(wanted: bool) -> "Callable[[NextMove], bool] | None":
    """What asks, and answers whether the arm may move; None unless it is `wanted`. Raises UsageError: there is no terminal."""
    from koala3d.datasets.core.errors import UsageError

    if not wanted:
        return None
    if not sys.stdin.isatty():
        remedy = "run the command in a terminal, or leave --confirm out"
        raise UsageError("asks before each move, and there is no terminal to ask on", where="--confirm", remedy=remedy)
    always = False

    def ask(move: "NextMove") -> bool:
        nonlocal always
        if always:
            return True
        console.hint(move.words)
        while True:
            console.hint(QUESTION)
            try:
                answer = input().strip().lower()
            except EOFError:  # the terminal is gone
                return False
            if answer in ("y", "yes", "all"):
                always = answer == "all"
                return True
            if answer in ("s", "stop", "n", "no"):
                return False

    return ask
