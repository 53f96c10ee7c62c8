import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from koala3d.datasets.core.extras import EXTRAS, not_installed

ROOT = Path(__file__).parents[3]


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
NEVER_MISSED = {"koala3d", "eaik", "llvmlite", "websockets"}
"""Koala's own code does the work of EAIK; the others come with Numba and with viser, which are imported before."""
BELOW = {"genicam": "harvesters"}
"""Modules that come with another distribution."""


def distributions(requirements: list[str]) -> set[str]:
    """Names of distributions, as their own files write them."""
    return {re.match(r"[\w.-]+", one)[0].lower() for one in requirements}


def test_every_extra_named_exists() -> None:
    assert set(EXTRAS.values()) <= set(PROJECT["optional-dependencies"])


def test_every_module_that_may_be_missing_names_its_extra() -> None:
    """What the library imports is Python's own, comes with Koala, or is brought by the extra that the message names."""
    imports = re.compile(r"^ *(?:from|import) (\w+)", re.MULTILINE)
    sources = [path for name in ("capture", "calib", "datasets", "reconstruct") for path in (ROOT / name).rglob("*.py")]
    imported = {name for path in sources for name in imports.findall(path.read_text())} - sys.stdlib_module_names
    own, known = distributions(PROJECT["dependencies"]), packages_distributions()
    optional = {name for name in imported if name in known and not own & {one.lower() for one in known[name]}}
    optional -= NEVER_MISSED
    assert len(optional) > 8, "the premise: the extras are installed"
    assert optional <= set(EXTRAS)
    for name in optional:
        brought = distributions(PROJECT["optional-dependencies"][EXTRAS[name]])
        assert brought & {BELOW.get(name, one.lower()) for one in known[name]}, f"{name} is not brought by {EXTRAS[name]}"


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
