"""URScript as a list of tokens: words, numbers, strings and marks. Blanks, newlines and comments only separate them.

That newlines do no more is seen in the program of the vendor's client, which breaks an assignment behind its "=".
"""

import re
from typing import NamedTuple

_TOKEN = re.compile(
    r"""(?P<newline>\n)
    | (?P<blank>[ \t\r]+ | [\#$][^\n]*)
    | (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)
    | (?P<string>"[^"\n]*")
    | (?P<word>[A-Za-z_]\w*)
    | (?P<mark>[=!<>]=|[-+*/%<>=()\[\],:.])""",
    re.ASCII | re.VERBOSE,
)


class ScriptError(Exception):
    """A controller does not take the program. `line` and `column` count from 1; 0: it has no place."""

    def __init__(self, why: str, line: int = 0, column: int = 0) -> None:
        super().__init__(f"line {line}, column {column}: {why}" if line else why)
        self.why, self.line, self.column = why, line, column


class Token(NamedTuple):
    """A part of the text and its place, counted from 1. `kind`: word, number, string, mark, or end for that of the text."""

    kind: str
    text: str
    line: int
    column: int


def tokens(text: str) -> list[Token]:
    """All of them, and one of kind "end". Raises ScriptError: a string without closing quote, or a strange character."""
    found, at, line, line_start = list[Token](), 0, 1, 0
    while at < len(text):
        match, column = _TOKEN.match(text, at), at - line_start + 1
        if match is None:
            what = "a string without its closing quote" if text[at] == '"' else f"the character {text[at]!r}"
            raise ScriptError(what, line, column)
        at, kind = match.end(), match.lastgroup or ""
        if kind == "newline":
            line, line_start = line + 1, at
        elif kind != "blank":
            found.append(Token(kind, match[0], line, column))
    return [*found, Token("end", "", line, len(text) - line_start + 1)]
