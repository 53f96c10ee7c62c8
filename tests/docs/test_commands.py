"""Every command in README.md and docs/ is one that exists, with options and settings that exist; the tutorial's are run.

A page's commands are parsed against the real command lines, which runs nothing: those for an arm that is not there too.
"""

import difflib
import importlib
import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer

from datasets.core.errors import KoalaError

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
PACKAGES = ("capture", "calib", "datasets", "reconstruct")


@dataclass(frozen=True)
class Quoted:
    """A command as a page has it."""

    page: Path
    line: int
    words: tuple[str, ...]
    mention: bool
    """In the midst of a sentence, where arguments may be left out."""

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}: {' '.join(self.words)}"


def code_lines(text: str) -> Iterator[tuple[int, str, str]]:
    """(line number, language, line) of all fenced and indented blocks; continued lines are joined."""
    fence, begun = "", ""
    previous_blank, inside = True, False
    for number, line in enumerate(text.splitlines(), 1):
        mark = re.match(r"```(\w*)", line)
        if mark:
            fence = "" if fence else mark[1] or "text"
            continue
        blank = not line.strip()
        inside = not fence and (line.startswith("    ") or (blank and inside)) and (inside or previous_blank)
        previous_blank = blank
        if blank or not (fence or inside):
            continue
        if line.rstrip().endswith("\\"):
            begun += line.rstrip()[:-1].strip() + " "
            continue
        yield number, fence or "indented", begun + line.strip()
        begun = ""


def without_explanation(line: str) -> str:
    """A command without the words that follow it after two or more spaces."""
    return re.split(r"\s{2,}", line.strip())[0]


def quoted_in_blocks(page: Path) -> list[Quoted]:
    """Every line of a shell block, and every line of an indented block that begins with one of the four commands."""
    found = []
    for number, language, line in code_lines(page.read_text()):
        if language in ("sh", "bash") or (language == "indented" and line.split()[0] in PACKAGES):
            found.append(Quoted(page, number, tuple(shlex.split(without_explanation(line))), False))
    return found


def quoted_in_sentences(page: Path) -> list[Quoted]:
    """`capture run ...` and its like, outside blocks."""
    inside = {number for number, _, _ in code_lines(page.read_text())}
    found = []
    for number, line in enumerate(page.read_text().splitlines(), 1):
        for code in re.findall(r"`([^`]+)`", line) if number not in inside else ():
            words = code.replace("\\|", "|").split()
            if words[0] in PACKAGES and len(words) > 1:
                found.append(Quoted(page, number, tuple(shlex.split(code)), True))
    return found


def parse(words: tuple[str, ...], *, mention: bool = False) -> dict[str, Any]:
    """Parse a command against the real command line, and run nothing.

    Args:
        words: the command, from its package on.
        mention: whether required arguments and values of options may be missing.

    Returns:
        Its parameters by name.

    Raises:
        AssertionError: there is no such command, option or choice; something required is missing.
    """
    package, *rest = words
    group: Any = typer.main.get_command(importlib.import_module(f"{package}.cli").app)
    own = {option for parameter in group.params for option in parameter.opts} | {"--help", "-h"}
    while rest and rest[0].startswith("-"):
        assert rest[0] in own, f"{package} has no option {rest[0]}"
        rest = rest[1:]
    if not rest:
        return {}
    name, *arguments = rest
    assert name in group.commands, f"{package} has no command {name}"
    command = group.commands[name]
    known = {option for parameter in command.params for option in parameter.opts} | {"--help", "-h"}
    unknown = {word.split("=")[0] for word in arguments if word.startswith("--")} - known
    assert not unknown, f"{package} {name} has no option {', '.join(sorted(unknown))}"
    try:
        with command.make_context(name, [word for word in arguments if word != "..."]) as context:
            return dict(context.params)
    except typer.Exit:
        return {}
    except Exception as error:
        kinds = {kind.__name__ for kind in type(error).__mro__}
        assert "ClickException" in kinds, error
        incomplete = bool(kinds & {"MissingParameter", "BadOptionUsage"})
        assert mention and incomplete, f"{error.format_message()}"  # type: ignore[attr-defined]
        return {}


BLOCKS = [quoted for page in PAGES for quoted in quoted_in_blocks(page)]
SENTENCES = [quoted for page in PAGES for quoted in quoted_in_sentences(page)]
OURS = [quoted for quoted in BLOCKS if quoted.words[0] in PACKAGES]


def test_there_are_commands() -> None:
    assert len(OURS) > 60 and len(SENTENCES) > 100
    assert {quoted.words[0] for quoted in OURS} == set(PACKAGES)


@pytest.mark.parametrize("quoted", [*OURS, *SENTENCES], ids=str)
def test_the_command_exists(quoted: Quoted) -> None:
    parameters = parse(quoted.words, mention=quoted.mention)
    settings = parameters.get("set_") or parameters.get("settings") or []
    trajectory = parameters.get("trajectory") or parameters.get("path")
    check_settings(quoted.words[0], list(settings), trajectory)
    if isinstance(trajectory, Path) and trajectory.parts[0] == "configs":
        assert (ROOT / trajectory).is_file(), f"{trajectory} does not exist"


def check_settings(package: str, settings: list[str], trajectory: Path | None = None) -> None:
    """Raise where a `--set` of a command is none that its files can have."""
    if package == "reconstruct":
        from reconstruct.models import load_config

        load_config("surfnerf", "fast", settings)
    elif package == "capture" and settings:
        from capture.trajectory import load_trajectory

        known = trajectory is not None and (ROOT / trajectory).is_file()
        load_trajectory(ROOT / (trajectory if known else "configs/trajectories/koala.yaml"), overrides=settings)


def test_settings_in_sentences_exist() -> None:
    for page in PAGES:
        for package, setting in re.findall(r"`(?:(capture|reconstruct)[^`]*)?--set ([\w.]+=[^ `]+)[^`]*`", page.read_text()):
            if setting == "key=value" or setting.endswith("=..."):
                continue
            accepted = []
            for candidate in (package,) if package else ("capture", "reconstruct"):
                try:
                    check_settings(candidate, [setting.strip("'")])
                    accepted.append(candidate)
                except KoalaError:
                    continue
            assert accepted, f"{page.name}: nothing takes --set {setting}"


def test_no_command_is_misspelt() -> None:
    """A line whose first word is nearly a command would not be tested as one."""
    for page in PAGES:
        for number, language, line in code_lines(page.read_text()):
            first = line.split()[0].rstrip(":")
            close = difflib.get_close_matches(first, PACKAGES, 1, 0.8)
            assert language == "python" or first in PACKAGES or "/" in first or not close, f"{page.name}:{number}: {line}"


@pytest.mark.parametrize("words", [
    "reconstruct train SCENE --out RUN --budgt 3", "reconstruct trian SCENE --out RUN", "reconstruct train --out",
    "calib handeye REC", "datasets convert SCENE --out X", "reconstruct mesh RUN --out M --resolution many", "capture --dbg run T",
])  # fmt: skip
def test_a_wrong_command_is_noticed(words: str) -> None:
    with pytest.raises(AssertionError):
        parse(tuple(words.split()))


def test_a_wrong_setting_is_noticed() -> None:
    with pytest.raises(KoalaError, match="did you mean"):
        check_settings("reconstruct", ["train.rat=0.1"])
    with pytest.raises(KoalaError, match="did you mean"):
        check_settings("capture", ["motion.sped=0.3"])


def test_other_programs_are_given_what_exists() -> None:
    """make: targets; pip: extras; pytest, cp: files. Another program in a shell block is known by name here."""
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M))
    extras = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    for page in PAGES:
        text = page.read_text()
        assert set(re.findall(r"(?:`|^    )make ([a-z-]+)", text, re.M)) <= targets, page.name
        assert set(re.findall(r"'\.\[(\w+)\]'", text)) <= extras, page.name
        for path in re.findall(
            r"(?<![\w/.-])((?:configs|tests|capture|calib|datasets|reconstruct|docs)/[\w/.-]+\.(?:py|yaml|md))", text
        ):
            assert "..." in path or (ROOT / path).is_file(), f"{page.name}: {path} does not exist"
    for quoted in BLOCKS:
        assert quoted.words[0] in (*PACKAGES, "colmap", "mkdir", "ssh"), str(quoted)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_command_runs_as_a_module_too(package: str) -> None:
    """Where it is not on the path; doing nothing without a word would be worse than failing."""
    done = subprocess.run([sys.executable, "-m", f"{package}.cli", "--help"], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and done.stdout.startswith("Usage:")


SMALL = {
    "configs/trajectories/calibration_demo.yaml": ["--set", "camera.binning=3", "--set", "camera.width=640", "--set", "camera.height=360"],
    "train": ["--budget", "45"], "mesh": ["--resolution", "48", "--level", "0.1"],
}  # fmt: skip
"""What makes the tutorial's steps small, by a word in them; what so short a training on a busy computer has learned is thin."""
FEWER = {"count: 50": "count: 15", "split: {train: 40, test: 10}": "split: {train: 12, test: 3}"}
"""What makes its session with the object short, in the trajectory's file."""


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_the_tutorial_leads_to_a_mesh(tmp_path: Path) -> None:
    """Every command of the tutorial in its order, in a folder with nothing but what the tutorial has made, with smaller
    pictures of the board and fewer of the object. Pages in the browser are opened and ended as a reader would, with Ctrl-C."""
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    session = tmp_path / "configs/trajectories/koala_demo.yaml"
    for whole, part in FEWER.items():
        assert whole in session.read_text()
        session.write_text(session.read_text().replace(whole, part))
    tutorial = [quoted for quoted in BLOCKS if quoted.page.name == "tutorial.md" and quoted.words[0] in PACKAGES]
    assert [quoted.words[1] for quoted in tutorial if quoted.words[0] == "reconstruct"] == [
        "train",
        "view",
        "eval",
        "report",
        "mesh",
    ]
    (tmp_path / "tutorial").mkdir()
    for quoted in tutorial:
        if quoted.words[1:] == ("--help",):
            continue
        smaller = [word for key, words in SMALL.items() if key in quoted.words for word in words]
        command = [sys.executable, "-m", f"{quoted.words[0]}.cli", *quoted.words[1:], *smaller]
        if quoted.words[1] == "view":
            look_at(command, tmp_path)
            continue
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, f"{quoted}: {done.stderr}"
    assert (tmp_path / "tutorial" / "mesh.ply").stat().st_size > 1000
    assert "<table" in (tmp_path / "tutorial" / "report" / "index.html").read_text()


def look_at(command: list[str], folder: Path) -> None:
    """Open a page, see that it is served, and end it with Ctrl-C."""
    process = subprocess.Popen([*command, "--port", "0", "--json"], cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        with urllib.request.urlopen(json.loads(process.stdout.readline())["url"], timeout=60) as answer:
            assert b"<html" in answer.read(4096).lower()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0
    finally:
        process.kill()
