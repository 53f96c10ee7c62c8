"""The pages as a reader gets them: they build without a warning, need nothing from elsewhere, and say what is so."""

import ast
import fnmatch
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
SOURCES = [path for package in ("capture", "calib", "datasets", "reconstruct") for path in (ROOT / package).rglob("*.py")]


def test_the_site_builds_without_a_warning_and_is_complete(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="mkdocs is absent: pip install '.[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert built.returncode == 0 and "WARNING" not in built.stderr, built.stderr
    start = (tmp_path / "site" / "index.html").read_text()
    assert not [path.stem for path in DOCS.glob("*.md") if f'href="{path.stem}.html"' not in start], (
        "the menu leads to every page"
    )
    fetched = r"(?:<(?:script|img|source|iframe)[^>]+src|<link[^>]+href)=[\"']?(?:https?:)?//[^\"' >]+"
    for path in [*(tmp_path / "site").rglob("*.html"), *(tmp_path / "site").rglob("*.css")]:
        text = path.read_text()
        outside = [*re.findall(fetched, text), *re.findall(r"url\([\"']?(?:https?:)?//[^)]+|@import[^;]+//[^;]+", text)]
        outside = [one for one in outside if 'rel="canonical"' not in one]
        assert not outside, f"{path.name} fetches {outside}"


def test_every_picture_is_used() -> None:
    shown = "".join(path.read_text() for path in [ROOT / "README.md", *DOCS.glob("*.md")])
    assert not [path.name for path in (DOCS / "pictures").iterdir() if f"pictures/{path.name}" not in shown]


def test_links_of_the_readme_lead_somewhere() -> None:
    for link in re.findall(r"\]\(([^)#]+)", (ROOT / "README.md").read_text()):
        assert (ROOT / link).is_file(), link


def test_every_figure_is_defined() -> None:
    from reconstruct.output import metrics
    from reconstruct.output.mesh import surface_distance

    text = (DOCS / "numbers.md").read_text()
    assert not [name for name in {**metrics.DEFINITIONS, **surface_distance.DEFINITIONS} if f"`{name}`" not in text]


def said_by_programs() -> list[list[str]]:
    """The words of every text in the source; a word with a value in it has a * there."""
    texts = []
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr):
                texts.append("".join(str(part.value) if isinstance(part, ast.Constant) else "*" for part in node.values))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return [re.sub(r"%[\d.]*[sdfg]", "*", text).replace("%%", "%").split() for text in texts]


def is_said(quoted: str, texts: list[list[str]]) -> bool:
    """Whether some text has these words one after the other."""
    words = quoted.split()
    return any(
        all(fnmatch.fnmatchcase(word.strip(":,;"), said.strip(":,;")) for word, said in zip(words, text[start:], strict=False))
        for text in texts
        for start in range(len(text) - len(words) + 1)
    )


@pytest.mark.parametrize("page", ["troubleshooting.md", "capture.md"])
def test_messages_are_those_of_the_programs(page: str) -> None:
    """The first column of the tables of symptoms quotes what a program says."""
    texts = said_by_programs()
    rows = re.findall(r"^\| (`[^|]+?) \|", (DOCS / page).read_text(), re.M)
    assert len(rows) > 10
    for row in rows:
        for quoted in re.findall(r"`([^`]+)`", row):
            parts = [part.strip() for part in re.split(r"\.\.\.|\(|\)", quoted)]
            assert all(is_said(part, texts) for part in parts if part), f"{page}: no program says {quoted!r}"


def test_a_message_that_nobody_says_is_noticed() -> None:
    texts = said_by_programs()
    assert is_said("is not a koala-calibration file", texts) and not is_said("is not a koala-calibration fil", texts)


@pytest.mark.timeout(900)
def test_the_code_on_extending_runs(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / "extending.md").read_text(), re.S)
    assert len(blocks) >= 6
    (tmp_path / "page.py").write_text("\n".join(blocks))
    done = subprocess.run([sys.executable, "page.py"], cwd=tmp_path, capture_output=True, text=True, timeout=800)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "two_views" / "frames.jsonl").is_file()
