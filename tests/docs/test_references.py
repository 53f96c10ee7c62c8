"""Files, functions and tests that the pages name exist, and the code on the pages runs."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
FOLDERS = "configs|tests|capture|calib|datasets|reconstruct|docs"
NAMED = re.compile(r"`([\w./-]+\.py):(\w+(?:\.\w+)?)`")
"""`path/file.py:function` or `path/file.py:Class.method`."""


@cache
def names_in(path: Path) -> frozenset[str]:
    """Functions, classes, methods and constants that a module defines."""
    names = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{inner.name}" for inner in node.body if isinstance(inner, ast.FunctionDef)}
        if isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return frozenset(names)


def exists(path: str, name: str) -> bool:
    """Whether a file of the repository defines a name."""
    return (ROOT / path).is_file() and name in names_in(ROOT / path)


def test_every_file_that_a_page_names_exists() -> None:
    missing = []
    for page in PAGES:
        text = page.read_text()
        paths = set(re.findall(rf"(?<![\w/.-])((?:{FOLDERS})/[\w/.-]+\.(?:py|yaml|md))", text))
        paths |= set(re.findall(rf"`((?:{FOLDERS})/[\w/-]*)`", text))
        paths |= set(re.findall(r"`([\w/.-]+\.py)`", text)) - {"page.py"}
        missing += [f"{page.name}: {path}" for path in sorted(paths) if "..." not in path and not (ROOT / path).exists()]
    assert not missing, "\n".join(missing)


def test_every_function_and_test_that_a_page_names_exists() -> None:
    wrong = []
    for page in PAGES:
        wrong += [f"{page.name}: {path}:{name}" for path, name in NAMED.findall(page.read_text()) if not exists(path, name)]
    assert not wrong, "\n".join(wrong)


def test_the_method_page_names_a_function_and_a_test_in_every_row() -> None:
    text = (ROOT / "docs" / "method.md").read_text().split("## Every deviation")[0]
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| ") and not line.startswith("| in the")]
    rows = [row for row in rows if row[0] != "| from"]
    assert len(rows) > 25
    for row in rows:
        assert NAMED.findall(row[2]) and NAMED.findall(row[3]), row
        assert all(path.startswith("tests/") for path, _ in NAMED.findall(row[3])), row


def test_a_wrong_reference_is_noticed() -> None:
    assert exists("reconstruct/config.py", "SurfaceConfig")
    assert not exists("reconstruct/config.py", "SurfaceConfigs") and not exists("reconstruct/configs.py", "Config")


@pytest.mark.timeout(900)
def test_the_code_on_extending_runs(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "extending.md").read_text(), re.S)
    assert len(blocks) >= 6
    (tmp_path / "page.py").write_text("\n".join(blocks))
    done = subprocess.run([sys.executable, "page.py"], cwd=tmp_path, capture_output=True, text=True, timeout=800)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "two_views" / "frames.jsonl").is_file()
