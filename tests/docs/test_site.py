"""The pages as a reader gets them: they build without a warning, load nothing from the network, and quote real messages."""

import ast
import fnmatch
import re
import subprocess
import sys
from collections import defaultdict
from functools import cache
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
    pages = [path.relative_to(DOCS).with_suffix(".html") for path in DOCS.rglob("*.md")]
    missing = [str(page) for page in pages if f'href="{page}"' not in start]
    assert not missing, f"not in the menu: {missing}"
    fetched = r"(?:<(?:script|img|source|iframe)[^>]+src|<link[^>]+href)=[\"']?(?:https?:)?//[^\"' >]+"
    for path in [*(tmp_path / "site").rglob("*.html"), *(tmp_path / "site").rglob("*.css")]:
        text = path.read_text()
        outside = [*re.findall(fetched, text), *re.findall(r"url\([\"']?(?:https?:)?//[^)]+|@import[^;]+//[^;]+", text)]
        outside = [one for one in outside if 'rel="canonical"' not in one]
        assert not outside, f"{path.name} fetches {outside}"


def test_every_picture_is_used() -> None:
    shown = "".join(path.read_text() for path in [ROOT / "README.md", *DOCS.rglob("*.md")])
    assert not [path.name for path in (DOCS / "pictures").iterdir() if f"pictures/{path.name}" not in shown]


def test_links_of_the_readme_lead_somewhere() -> None:
    for link in re.findall(r"\]\(([^)#]+)", (ROOT / "README.md").read_text()):
        assert link.startswith("https://arxiv.org/") or (ROOT / link).is_file(), link


def test_every_figure_is_defined() -> None:
    from koala3d.reconstruct.output import metrics
    from koala3d.reconstruct.output.mesh import surface_distance

    text = (DOCS / "numbers.md").read_text()
    assert not [name for name in {**metrics.DEFINITIONS, **surface_distance.DEFINITIONS} if f"`{name}`" not in text]


@cache
def source() -> dict[str, list[list[str]]]:
    """What follows each word in the strings of the source, itself the first; `*` stands for a value in a word."""
    found: dict[str, list[list[str]]] = defaultdict(list)
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr):
                text = "".join(str(part.value) if isinstance(part, ast.Constant) else "*" for part in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                text = node.value
            else:
                continue
            words = words_of(re.sub(r"%[\d.]*[sdfg]", "*", text).replace("%%", "%"))
            for start, word in enumerate(words):
                found[word].append(words[start : start + LONGEST])
    return found


LONGEST = 20
"""Words of a quoted message that are looked at."""


def words_of(text: str) -> list[str]:
    """Words without the punctuation that ends them."""
    return [word.strip(":,;") for word in text.split()]


def is_message(quoted: str) -> bool:
    """Whether a string of the source has these words one after the other."""
    words = words_of(quoted)[:LONGEST]
    starts = (texts for word, texts in source().items() if alike(words[0], word))
    return any(len(text) >= len(words) and all(map(alike, words, text)) for texts in starts for text in texts)


def alike(word: str, pattern: str) -> bool:
    """Whether a word fits one of the source, where `*` stands for anything."""
    return word == pattern or ("*" in pattern and fnmatch.fnmatchcase(word, pattern))


def test_quoted_messages_exist() -> None:
    """The first column of the tables of symptoms quotes messages of the programs."""
    missing = []
    for page in ("troubleshooting.md", "capture.md"):
        rows = re.findall(r"^\| (`[^|]+?) \|", (DOCS / page).read_text(), re.M)
        assert len(rows) > 10
        for quoted in (quoted for row in rows for quoted in re.findall(r"`([^`]+)`", row)):
            parts = [part.strip() for part in re.split(r"\.\.\.|\(|\)", quoted)]
            missing += [f"{page}: {quoted}" for part in parts if part and not is_message(part)]
    assert not missing, "\n".join(missing)


def test_a_message_that_does_not_exist_is_noticed() -> None:
    assert is_message("is not a koala-calibration file") and not is_message("is not a koala-calibration fil")


def test_the_tree_of_folders_is_that_of_the_disk() -> None:
    """The drawing in docs/index.md names each folder of the four packages, and no other."""
    text = (DOCS / "index.md").read_text().split("## Which folder does what", 1)[1].split("```")[1]
    drawn = set(re.findall(r"\b([a-z_]+)/", text))
    there = {
        path.name
        for package in ("capture", "calib", "datasets", "reconstruct")
        for path in (ROOT / package).iterdir()
        if (path / "__init__.py").is_file()
    }
    assert there <= drawn, f"missing in the drawing: {sorted(there - drawn)}"
    inner = {path.name for path in [*ROOT.iterdir(), *(ROOT / "configs").iterdir(), *(ROOT / "reconstruct/training").iterdir()]}
    assert drawn <= there | inner, f"drawn, but not there: {sorted(drawn - there - inner)}"
