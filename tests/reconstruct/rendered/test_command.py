"""`reconstruct scenes` refuses what it cannot render before it renders."""

from pathlib import Path

from typer.testing import CliRunner

from koala3d.reconstruct.cli import app


def test_names_are_checked(tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["scenes", "--scene", "tepot", "--out", str(tmp_path)])
    assert "did you mean 'teapot'" in str(said.exception)
