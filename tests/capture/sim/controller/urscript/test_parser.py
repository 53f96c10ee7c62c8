"""What the simulated controller takes for a program in URScript: programs of our own, and those that both clients upload."""

import itertools

import pytest

from koala3d.capture.drivers.ur.link import Deadlines
from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.drivers.ur.rtde import program
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.capture.sim.controller.urscript.builtin import FUNCTIONS
from koala3d.capture.sim.controller.urscript.lexer import ScriptError
from koala3d.capture.sim.controller.urscript.parser import RESERVED, check

STATEMENTS = (
    "halt",
    "break",
    "continue",
    "pass",
    "enter_critical\n exit_critical",
    "return",
    "return -x + 2",
    "return (x)",
    "sync()",
    "x = 1",
    "global x = 1.5e-3",
    "local x = .5",
    "x[0] = 2",
    "x.left = 3",
    "handle = run other()",
    "run other()",
    "kill handle",
    "join handle",
    'textmsg("a # is no comment, end is no word: ", x)',
    "movej([0, -1.57, 0, 0, 0, 0], a=1.4, v=1.05, t=0, r=0)",
    "movel(pose_trans(p[0.1, 0, 0, 0, 0, 3.14], get_actual_tcp_pose()), a=1.2)",
    "x = not (a == 1 and b != 2.0) or c <= 3 xor d >= 4 and not e",
    "x = -(a + 1) * b[2 + i] / c(1)[0] % 7",
    "x = []",
    "x = [[1, 2], [3, 4]]",
    "x = matrix[1, 2]",
    'x = "hello" + " " + name',
    "x = server.method(1)",
    "x = y # a comment with 'end' and \"quotes",
    "$ 12 what the pendant writes between statements",
    "x = # continues\n 0 global y = 1",
    "if x: halt end",
    "while (True):\n sync()\n end",
    "def inner(a, b=2):\n return a + b\n end",
    "thread inner():\n halt\n end",
)
PLACES = (
    "{}",
    "def f():\n {}\n end",
    "thread t():\n {}\n end",
    "if x > 0:\n {}\n end",
    "if x:\n y = 1\n elif z:\n {}\n elif w:\n y = 2\n end",
    "if x:\n else:\n {}\n end",
    "while not x:\n {}\n end",
)


OTHERS = ("def c(a):", "return [a]", "end", "thread other():", "sync()", "end")
"""What the statements call; it may stand behind them."""


def program_of(*lines: str) -> str:
    return "\n".join(["def program():", *lines, "end", ""])


@pytest.mark.parametrize("statement", STATEMENTS)
def test_every_statement_is_taken_in_every_place(statement: str) -> None:
    for outer, inner in itertools.product(PLACES, PLACES):
        program = program_of(outer.format(inner.format(statement)), "x = 0", *OTHERS)
        check(program)
        with pytest.raises(ScriptError):  # nothing is taken for the block's end
            check(program.removesuffix("end\n"))


def test_indentation_does_not_matter() -> None:
    check("   def program():\n\t\tif x:\nhalt\n      end\n  end")


@pytest.mark.parametrize("word", sorted(RESERVED))
def test_a_word_of_the_language_is_no_name(word: str) -> None:
    for line in (f"def {word}():\n end", f"thread {word}():\n end", f"global {word} = 1", f"x.{word} = 1", f"run {word}()"):
        with pytest.raises(ScriptError, match=f"line 3, column .*'{word}' is a word of the language"):
            check(program_of("x = 1", line))
    with pytest.raises(ScriptError):
        check(program_of(f"{word} = 1"))
    with pytest.raises(ScriptError, match=f"'{word}' is a word"):
        check(program_of(f"def f(a, {word}):", "end"))


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ("halt()", r"line 2, column 5: '\(' in place of a name"),  # as the vendor's simulator does
        ('textmsg("x", f()', r"line 3, column 1: 'end' in place of '\)'"),  # the line that a controller names too
        ("if x:", r"line 4, column 1: the end of the program in place of 'end' of the 'def' in line 1"),
        ("end", "line 3, column 1: 'end' in place of a definition"),
        ("while x:\n else:\n end", "line 3, column 2: 'else' in place of 'end'"),
        ("if x:\n else:\n elif y:\n end", "line 4, column 2: 'elif' in place of 'end'"),
        ("if x\n halt\n end", "line 3, column 2: 'halt' in place of ':'"),
        ("if :\n end", "':' in place of an expression"),
        ('x = "never closed', "line 2, column 5: a string without its closing quote"),
        ('x = "two\nlines"', "line 2, column 5: a string without its closing quote"),
        ("x = 1 +", "line 3, column 1: 'end' in place of an expression"),
        ("x = (1", r"'end' in place of '\)'"),
        ("x = (1, 2)", r"',' in place of '\)'"),
        ("x = ()", r"'\)' in place of an expression"),
        ("x = [1, 2", r"'end' in place of '\]'"),
        ("x[] = 1", r"'\]' in place of an expression"),
        ("x + 1", r"'\+' in place of '='"),
        ("x", "'end' in place of '='"),
        ("f() = 1", "'=' in place of a name"),
        ("global f()", "'end' in place of '='"),
        ("x += 1", r"'\+' in place of '='"),
        ("1 = x", "'1' in place of a name"),
        ("x = 1; y = 2", "line 2, column 6: the character ';'"),
        ("def f:\n end", r"':' in place of '\('"),
        ("kill", "line 3, column 1: 'end' in place of an expression"),
        ("for i in x:\n end", "line 2, column 1: URScript has no 'for': a loop is written with 'while'"),
        ("if x:\n for (i = 0):\n end\n end", "line 3, column 2: URScript has no 'for'"),
        ("moveJ([0, 0, 0, 0, 0, 0])", "line 2, column 1: there is no function 'moveJ'; did you mean 'movej'?"),
        ("x = [1, 2 + inverse(3)]", "line 2, column 13: there is no function 'inverse'"),
        ("if not known(x):\n end", "line 2, column 8: there is no function 'known'"),
        ("while f(g(1)):\n end\n def f(a):\n end", "line 2, column 9: there is no function 'g'"),
        ("t = run movej()", "line 2, column 9: there is no thread 'movej'"),
        ("run other()", "line 2, column 5: there is no thread 'other'"),
        ("x = " + "(" * 5000, "more than 100 blocks and brackets"),
        ("if x:\n" * 5000, "more than 100 blocks and brackets"),
    ],
)
def test_what_a_controller_does_not_compile_is_refused_with_its_place(lines: str, why: str) -> None:
    with pytest.raises(ScriptError, match=why):
        check(program_of(lines))


def test_functions_are_known_wherever_they_are_defined() -> None:
    check(program_of("f(1)", "def f(a):\n g(a)\n end", "def g(a):\n f(a)\n end", "x = server.any_method(1)"))
    check(program_of("first()") + "def first():\nend\n")
    for name in FUNCTIONS:
        check(program_of(f"{name}()"))
    assert len(FUNCTIONS) > 250 and not FUNCTIONS & RESERVED


def test_a_statement_outside_a_program_is_refused() -> None:
    with pytest.raises(ScriptError, match="line 1, column 1: 'movej' in place of a definition"):
        check("movej([0, 0, 0, 0, 0, 0])\n")


@pytest.mark.both_clients
def test_what_a_client_uploads_compiles_and_nothing_in_it_can_be_left_out(client: str) -> None:
    with SimulatedController.start() as simulated:
        with UniversalRobot(simulated.host, client=client, deadlines=Deadlines(stale_s=1.0, watchdog_hz=1.0)):
            text = simulated.ask("program")["text"]
    check(text)
    assert client == "ur_rtde" or text == program.text()
    lines = text.splitlines()
    needed = [
        number for number, line in enumerate(lines) if line.split()[:1] in (["def"], ["thread"], ["if"], ["while"], ["end"])
    ]
    assert len(needed) > 20
    for number in needed[:: max(1, len(needed) // 20)]:
        with pytest.raises(ScriptError):
            check("\n".join([*lines[:number], *lines[number + 1 :]]))
