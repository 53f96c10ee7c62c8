import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from koala3d.datasets.core.extras import EXTRAS, not_installed

ROOT = Path(__file__).parents[3]


def test_every_extra_named_exists() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(EXTRAS.values()) <= set(project["optional-dependencies"])


@pytest.mark.parametrize(("module", "expected"), [("viser", "pip install 'koala-capture[view]'"), ("pycolmap", "wheels")])
def test_missing_package_is_one_line_with_what_to_install(module: str, expected: str) -> None:
    error = not_installed(ModuleNotFoundError(name=f"{module}.part"))
    assert error is not None and expected in str(error) and "\n" not in str(error)


def test_other_missing_modules_are_not_ours() -> None:
    assert not_installed(ModuleNotFoundError(name="no_such_module")) is None


def test_command_without_its_extra_ends_with_one_line(tmp_path: Path) -> None:
    """The import of viser is refused in a fresh interpreter, as if it were not installed."""
    program = "import sys; sys.modules['viser'] = None; sys.argv = ['datasets', 'view', sys.argv[1]]\n"
    program += "from koala3d.datasets.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "viser is not installed; pip install 'koala-capture[view]'" in done.stderr
