"""Files, functions and tests that the pages name exist, and the code on the pages runs."""

import ast
import re
import runpy
from functools import cache
from pathlib import Path

import pytest

from koala3d.datasets import formats
from tests.reconstruct import glossy_ball

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
"""All but lab notes, whose commands, settings and names are those of their date."""
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


def test_modules_that_code_on_the_pages_imports_exist() -> None:
    missing = []
    for page in PAGES:
        for module in re.findall(rf"^from ((?:{FOLDERS})[\w.]*) import", page.read_text(), re.M):
            path = ROOT / module.replace(".", "/")
            missing += [] if path.with_suffix(".py").is_file() or path.is_dir() else [f"{page.name}: {module}"]
    assert not missing, "\n".join(missing)


@pytest.mark.timeout(900)
def test_the_code_on_extending_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "extending.md").read_text(), re.S)
    assert len(blocks) >= 6
    (tmp_path / "page.py").write_text("\n".join(blocks))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(formats, "FORMATS", dict(formats.FORMATS))  # to which the page adds one
    runpy.run_path("page.py", run_name="page")
    assert (tmp_path / "two_views" / "frames.jsonl").is_file()


@pytest.mark.timeout(300)
def test_the_example_of_the_readme_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the glossy ball and with its small model; the calls are those of the page."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    assert sum(bool(line) and not line.startswith("from ") for line in code.splitlines()) == 5
    changes = {
        '"demo/koala/gold_head"': repr(str(glossy_ball.save(tmp_path))),
        '"fast")': f'"fast", {glossy_ball.SETTINGS!r})',
        "budget_s=60": "budget_s=1",
    }
    for shown, run in changes.items():
        assert shown in code
        code = code.replace(shown, run)
    (tmp_path / "example.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    runpy.run_path("example.py", run_name="example")
    assert capsys.readouterr().out.endswith("dB on test views\n")
