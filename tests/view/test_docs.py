"""The page on pages names commands and options that exist."""

import importlib
from pathlib import Path

import typer

TEXT = (Path(__file__).parents[2] / "docs" / "view.md").read_text()


def test_the_documentation_names_commands_and_options_that_exist() -> None:
    lines = [line.split() for line in TEXT.splitlines() if line.startswith("    ") and not line.strip().startswith("ssh")]
    assert len(lines) >= 8
    for package, name, *words in lines:
        command = typer.main.get_command(importlib.import_module(f"{package}.cli").app).commands[name]
        known = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= known, (package, name)
    assert {package for package, name, *_ in lines if name == "view"} == {"capture", "calib", "datasets", "reconstruct"}
