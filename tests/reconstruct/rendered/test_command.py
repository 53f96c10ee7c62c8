"""`reconstruct scenes` refuses what it cannot render before it renders."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from koala3d.reconstruct.cli import app


@pytest.mark.parametrize(("wrong", "meant"), [(("--scene", "tepot"), "teapot"), (("--format", "blendr"), "blender")])
def test_names_are_checked(wrong: tuple[str, str], meant: str, tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["scenes", *wrong, "--out", str(tmp_path)])
    assert f"did you mean '{meant}'" in str(said.exception)
