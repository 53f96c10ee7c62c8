"""Help appears at once: only libraries that draw it are imported. That takes 0.1 to 0.2 s; NumPy alone would double it."""

import json
import subprocess
import sys
from importlib.metadata import distribution, packages_distributions

import pytest
from packaging.requirements import Requirement

DRAWS_HELP = {"typer", "rich", "pydantic"}
"""Some versions of typer parse option types with pydantic."""
PROGRAM = (
    "import atexit, json, sys\n"
    "atexit.register(lambda: print(json.dumps(sorted({{name.split('.')[0] for name in sys.modules}})), file=sys.stderr))\n"
    "from koala3d.{package}.cli import main; main()"
)


def libraries() -> set[str]:
    """Top-level modules of all dependencies, except those that draw help."""
    required = map(Requirement, distribution("koala-capture").requires or [])
    wanted = {requirement.name.lower() for requirement in required} - DRAWS_HELP - {"koala-capture"}  # extras name it
    return {module for module, names in packages_distributions().items() if wanted & {name.lower() for name in names}}


def test_the_list_of_libraries_is_not_empty() -> None:
    assert {"numpy", "scipy", "jax", "cv2", "pycolmap", "mitsuba", "matplotlib", "yaml", "viser"} <= libraries()


@pytest.mark.parametrize(
    ("package", "arguments", "words"),
    [
        ("capture", [], ["run", "plan", "calibrate", "check", "sim", "view", "doctor"]),
        ("calib", [], ["intrinsics", "handeye", "board", "view"]),
        ("calib", ["handeye"], ["RECORDING"]),
        ("datasets", [], ["build", "info", "check", "export"]),
        (
            "reconstruct",
            [],
            [
                "Main way",
                "Look",
                "Check",
                "Study",
                "train",
                "eval",
                "mesh",
                "asset",
                "splats",
                "view",
                "report",
                "render",
                "light",
                "diagnose",
                "models",
                "backend",
                "series",
                "sweep",
                "table",
                "scenes",
            ],
        ),
        ("reconstruct", ["train"], ["--preset", "--budget", "--resume", "--list-settings", "Several machines"]),
    ],
)
def test_help_imports_nothing_heavy_and_lists_commands_and_options(package: str, arguments: list[str], words: list[str]) -> None:
    program = [sys.executable, "-c", PROGRAM.format(package=package), *arguments, "--help"]
    done = subprocess.run(program, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert all(word in done.stdout for word in words)
    loaded = set(json.loads(done.stderr.splitlines()[-1]))
    assert "typer" in loaded and not libraries() & loaded
