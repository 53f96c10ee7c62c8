import importlib.util
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def check():
    spec = importlib.util.spec_from_file_location("install_check", Path(__file__).with_name("check.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def interpreter(folder: Path, name: str, version: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(f"#!/bin/sh\necho Python {version}\n")
    (folder / name).chmod(0o755)


def test_newest_patch_of_each_python_that_is_new_enough(check, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interpreter(tmp_path / "bin", "python3.12", "3.12.1")
    interpreter(tmp_path / "bin", "python3.9", "3.9.18")
    interpreter(tmp_path / "pyenv" / "versions" / "3.12.7" / "bin", "python", "3.12.7")
    interpreter(tmp_path / "pyenv" / "versions" / "3.14.0" / "bin", "python", "3.14.0")
    (tmp_path / "bin" / "python3.13").write_text("not a program")
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
    found = check.pythons()
    assert {version: path.parts[-3] for version, path in found.items()} == {"3.12": "3.12.7", "3.14": "3.14.0"}


def test_a_failed_step_shows_the_last_lines_of_its_command(check, tmp_path: Path) -> None:
    installed = check.Installation(tmp_path, "3.12")
    with pytest.raises(check.CheckFailed, match="no such thing"):
        installed.run(sys.executable, "-c", "import sys; sys.exit('no such thing')")
