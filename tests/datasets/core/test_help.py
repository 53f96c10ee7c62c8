"""Help is written whole, in panels, on a terminal of any width."""

from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from koala3d.datasets.core import console

SENTENCE = "Make a scene of many photographs that were taken one after the other with a camera in a hand by somebody who walks"


@pytest.fixture
def text() -> str:
    app = console.make_app("little", "A command.")

    @app.command(panel=console.CHECK, help=f"{SENTENCE}. A second sentence.")
    def scene(size: Annotated[int, typer.Option(help="How large.", rich_help_panel="Shape")] = 3) -> None: ...

    @app.command(panel=console.MAIN)
    def first() -> None:
        """Begin."""

    runner = CliRunner()
    return "".join(runner.invoke(app, words, terminal_width=200).output for words in (["--help"], ["scene", "--help"]))


def test_no_sentence_is_cut_off(text: str) -> None:
    assert any(line.split(maxsplit=1)[1:] == [SENTENCE + "."] for line in text.splitlines()) and "A second" in text


def test_commands_and_options_are_in_their_panels(text: str) -> None:
    titles = [line.rstrip(":") for line in text.splitlines() if line.endswith(":")]
    assert titles == ["Options", console.MAIN, console.CHECK, "Options", "Shape"]
