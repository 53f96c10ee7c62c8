import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheels():
    spec = importlib.util.spec_from_file_location("wheels", ROOT / "docs" / "wheels.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["wheels"] = module
    spec.loader.exec_module(module)
    return module


def test_requirements_keep_ranges_and_drop_markers_extras_and_ourselves(wheels) -> None:
    found = wheels.requirements()
    assert found["opencv-contrib-python-headless"] == "opencv-contrib-python-headless>=4.12,<5"
    assert found["ur-rtde"] == "ur-rtde>=1.6.5"
    assert "koala-capture" not in found and "pytest" not in found


@pytest.mark.parametrize(
    ("found", "words"),
    [([], "–"), (["3.12"], "3.12"), (["3.11", "3.12", "3.13"], "3.11 to 3.13"), (["3.11", "3.13", "3.14"], "3.11, 3.13 to 3.14")],
)
def test_versions_are_ranges(wheels, found: list[str], words: str) -> None:
    assert wheels.versions(found) == words


def test_page_has_the_place_for_the_table(wheels) -> None:
    text = wheels.PAGE.read_text()
    assert text.count(wheels.BEGIN) == text.count(wheels.END) == 1


def test_every_python_has_a_lock() -> None:
    assert {path.name for path in (ROOT / "constraints").iterdir()} == {f"python3.{minor}.txt" for minor in (11, 12, 13, 14)}
