"""Whether a text is a program in URScript. It is read as a controller compiles it, and refused for the same reasons.

    program      definition {definition}
    definition   ("def" | "sec" | "thread") name "(" [parameter {"," parameter}] ")" ":" {statement} "end"
    statement    definition | assignment | call | "run" call | ("kill" | "join") expression | "return" [expression]
                 | "if" expression ":" {statement} {"elif" expression ":" {statement}} ["else" ":" {statement}] "end"
                 | "while" expression ":" {statement} "end"
                 | "halt" | "break" | "continue" | "pass" | "enter_critical" | "exit_critical"
    assignment   ["global" | "local"] place "=" expression

Expressions have the usual operators. Their precedence is not read, since nothing is computed. Every function that is called by
its name must be defined somewhere in the program, or be one of URScript's own. The language has no `for`.
"""

from collections.abc import Callable
from difflib import get_close_matches

from koala3d.capture.sim.controller.urscript.builtin import FUNCTIONS
from koala3d.capture.sim.controller.urscript.lexer import ScriptError, Token, tokens

DEFINITIONS = frozenset("def sec thread".split())
STATEMENTS = frozenset("halt break continue pass enter_critical exit_critical".split())
"""Words that are statements by themselves."""
OPERATORS = frozenset("+ - * / % == != < <= > >= and or xor".split())
SIGNS = frozenset("+ - not".split())
RESERVED = DEFINITIONS | STATEMENTS | frozenset("if elif else while for end return run kill join global local".split())
RESERVED |= frozenset("and or xor not True False".split())
"""Words that can be no name."""
MAX_DEPTH = 100  # of blocks and brackets in each other


def check(text: str) -> None:
    """Return if `text` is a program. Raises ScriptError: it is none, and why."""
    parser = _Parser(text)
    while not parser.at_end:
        parser.definition()
    parser.check_calls()


class _Parser:
    """Reads token after token; every method consumes what it is named for."""

    def __init__(self, text: str) -> None:
        self._tokens, self._index, self._depth = tokens(text), 0, 0
        self._defined, self._called = set[str](), list[tuple[Token, bool]]()

    @property
    def _token(self) -> Token:
        """The next one."""
        return self._tokens[self._index]

    @property
    def at_end(self) -> bool:
        """Whether nothing is left."""
        return self._token.kind == "end"

    def definition(self) -> None:
        """A function, a thread, or the program itself."""
        if self._token.text not in DEFINITIONS:
            raise self._unexpected("a definition")
        begun = self._take()
        self._defined.add(self._name().text)
        self._expect("(")
        self._list(")", self._parameter)
        self._body(begun)
        self._expect("end")

    def check_calls(self) -> None:
        """Raises ScriptError: a function is called that neither the program nor the language has."""
        for name, is_own in self._called:
            known = self._defined if is_own else self._defined | FUNCTIONS
            if name.text not in known:
                same = [other for other in known if other.lower() == name.text.lower()]
                close = same or get_close_matches(name.text, sorted(known), 1)
                hint = f"; did you mean '{close[0]}'?" if close else ""
                raise ScriptError(f"there is no {'thread' if is_own else 'function'} '{name.text}'{hint}", *name[2:])

    def _statement(self) -> None:
        word = self._token.text
        if word in DEFINITIONS:
            self.definition()
        elif word in ("if", "while"):
            self._conditional()
        elif word in STATEMENTS:
            self._take()
        elif word in ("kill", "join"):
            self._take()
            self._expression()
        elif word == "return":
            line = self._take().line
            if self._begins_expression and self._token.line == line:
                self._expression()
        elif word == "run":
            self._operand()
        elif word == "for":
            raise ScriptError("URScript has no 'for': a loop is written with 'while'", *self._token[2:])
        else:
            self._assignment_or_call()

    def _conditional(self) -> None:
        begun = self._take()
        self._expression()
        self._body(begun)
        while begun.text == "if" and self._token.text == "elif":
            self._take()
            self._expression()
            self._body(begun)
        if begun.text == "if" and self._accept("else"):
            self._body(begun)
        self._expect("end")

    def _body(self, begun: Token) -> None:
        """The colon and the statements after it, up to the word that ends them."""
        self._expect(":")
        self._deeper(1)
        while self._token.text not in ("end", "elif", "else"):
            if self.at_end:
                raise self._unexpected(f"'end' of the '{begun.text}' in line {begun.line}")
            self._statement()
        self._deeper(-1)

    def _assignment_or_call(self) -> None:
        declared = self._accept("global") or self._accept("local")
        called = self._suffixes(self._name())
        if declared or not called:
            self._expect("=")
            self._expression()

    def _expression(self) -> None:
        self._operand()
        while self._token.text in OPERATORS:
            self._take()
            self._operand()

    @property
    def _begins_expression(self) -> bool:
        kind, text = self._token.kind, self._token.text
        if kind == "word":
            return text not in RESERVED or text in ("not", "run", "True", "False")
        return kind in ("number", "string") or text in ("(", "[", "-", "+")

    def _operand(self) -> None:
        if not self._begins_expression:
            raise self._unexpected("an expression")
        while self._token.text in SIGNS:
            self._take()
        name: Token | None = None
        if self._accept("run"):
            self._called.append((self._name(), True))
            self._expect("(")
            self._list(")", self._argument)
        elif self._accept("("):
            self._deeper(1)
            self._expression()
            self._deeper(-1)
            self._expect(")")
        elif self._accept("["):
            self._list("]", self._expression)
        elif self._token.kind in ("number", "string") or self._token.text in ("True", "False"):
            self._take()
        else:
            name = self._name()
        self._suffixes(name)

    def _suffixes(self, name: Token | None) -> bool:
        """Arguments, indices and members behind a value, or behind a name; returns whether the last of them are arguments."""
        called = False
        if name is not None and self._token.text == "(":
            self._called.append((name, False))
        while self._token.text in ("(", "[", "."):
            mark = self._take().text
            called = mark == "("
            if mark == ".":
                self._name()
            elif called:
                self._list(")", self._argument)
            else:  # numbers of a pose too: "p" is a name here
                self._list("]", self._expression, at_least_one=True)
        return called

    def _argument(self) -> None:
        """An expression, or name = expression."""
        if self._token.kind == "word" and self._tokens[self._index + 1].text == "=":
            self._parameter()
        else:
            self._expression()

    def _parameter(self) -> None:
        self._name()
        if self._accept("="):
            self._expression()

    def _list(self, closing: str, part: Callable[[], None], *, at_least_one: bool = False) -> None:
        """Parts between commas, and the closing bracket."""
        self._deeper(1)
        if at_least_one or self._token.text != closing:
            part()
            while self._accept(","):
                part()
        self._expect(closing)
        self._deeper(-1)

    def _name(self) -> Token:
        if self._token.kind == "word" and self._token.text in RESERVED:
            raise ScriptError(f"'{self._token.text}' is a word of the language and can be no name", *self._token[2:])
        if self._token.kind != "word":
            raise self._unexpected("a name")
        return self._take()

    def _take(self) -> Token:
        self._index += 1
        return self._tokens[self._index - 1]

    def _accept(self, text: str) -> bool:
        """Whether the next token is this one; it is taken then."""
        return self._token.text == text and bool(self._take())

    def _expect(self, text: str) -> None:
        if not self._accept(text):
            raise self._unexpected(f"'{text}'")

    def _deeper(self, step: int) -> None:
        self._depth += step
        if self._depth > MAX_DEPTH:
            raise ScriptError(f"more than {MAX_DEPTH} blocks and brackets in each other", *self._token[2:])

    def _unexpected(self, wanted: str) -> ScriptError:
        met = "the end of the program" if self.at_end else f"'{self._token.text}'"
        return ScriptError(f"{met} in place of {wanted}", *self._token[2:])
