"""Every command in README.md and docs/ exists, with options and settings that exist; the tutorial's commands are run.

Commands are parsed against the real command lines and not run, so those that need an arm or a camera are checked as well.
"""

import difflib
import importlib
import json
import re
import shlex
import signal
import subprocess
import sys
import tomllib
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer

from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.core.help import PANELS
from koala3d.reconstruct.listing import settings
from koala3d.reconstruct.models import load_config

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
"""All but lab notes, whose commands, settings and names are those of their date."""
PACKAGES = ("capture", "calib", "datasets", "reconstruct")


@dataclass(frozen=True)
class Quoted:
    """A command as a page quotes it."""

    page: Path
    line: int
    words: tuple[str, ...]
    mention: bool
    """Quoted inside a sentence, where arguments may be left out."""

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}: {' '.join(self.words)}"


def code_lines(text: str) -> Iterator[tuple[int, str, str]]:
    """(line number, language, line) of all fenced and indented code blocks; continued lines are joined."""
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
    """A command without the explanation that follows it after two or more spaces."""
    return re.split(r"\s{2,}", line.strip())[0]


def quoted_in_blocks(page: Path) -> list[Quoted]:
    """Every line of a shell block, and every line of an indented block that begins with one of the four commands."""
    found = []
    for number, language, line in code_lines(page.read_text()):
        if language in ("sh", "bash") or (language == "indented" and line.split()[0] in PACKAGES):
            found.append(Quoted(page, number, tuple(shlex.split(without_explanation(line))), False))
    return found


def quoted_in_sentences(page: Path) -> list[Quoted]:
    """Commands in backticks, outside code blocks."""
    inside = {number for number, _, _ in code_lines(page.read_text())}
    found = []
    for number, line in enumerate(page.read_text().splitlines(), 1):
        for code in re.findall(r"`([^`]+)`", line) if number not in inside else ():
            words = code.replace("\\|", "|").split()
            if words[0] in PACKAGES and len(words) > 1:
                found.append(Quoted(page, number, tuple(shlex.split(code)), True))
    return found


@cache
def command_line(package: str) -> Any:
    """A package's commands."""
    return typer.main.get_command(importlib.import_module(f"koala3d.{package}.cli").app)


def parse(words: tuple[str, ...], *, mention: bool = False) -> dict[str, Any]:
    """Parse a command against the real command line without running it.

    Args:
        words: the command, starting with its package.
        mention: whether required arguments and values of options may be missing.

    Returns:
        Its parameters by name.

    Raises:
        AssertionError: the command, an option or a choice does not exist, or a required argument is missing.
    """
    package, *rest = words
    group = command_line(package)
    own = {option for parameter in group.params for option in parameter.opts} | {"--help", "-h"}
    while rest and rest[0].startswith("-"):
        assert rest[0] in own, f"{package} has no option {rest[0]}"
        rest = rest[1:]
    if not rest:
        return {}
    name, *arguments = rest
    assert name in group.commands, f"{package} has no command {name}"
    command = group.commands[name]
    if arguments and arguments[0] in getattr(command, "commands", {}):
        name, *arguments = arguments
        command = command.commands[name]
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)} | {"--help", "-h"}
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


def problem_of(quoted: Quoted) -> str | None:
    """What is wrong with a quoted command; None if nothing is."""
    try:
        parameters = parse(quoted.words, mention=quoted.mention)
        settings = parameters.get("set_") or parameters.get("settings") or []
        trajectory = parameters.get("trajectory") or parameters.get("path")
        check_settings(quoted.words[0], list(settings), trajectory)
    except (AssertionError, KoalaError) as error:
        return f"{quoted}: {error}"
    if quoted.words[0] == "capture" and isinstance(trajectory, Path) and shipped(trajectory) is None:
        return f"{quoted}: {trajectory} does not exist"
    return None


def shipped(trajectory: Path) -> Path | None:
    """The file of a shipped trajectory, by path or by name; a placeholder or a file of the reader's own stands for koala.yaml."""
    folder = ROOT / "configs" / "trajectories"
    if trajectory.parts[0] == "configs":
        path = ROOT / trajectory
    elif trajectory.name.islower() and (
        trajectory.stem.startswith(("koala", "calibration_")) and not trajectory.suffix == ".json"
    ):
        path = folder / trajectory.with_suffix(".yaml")
    else:
        path = folder / "koala.yaml"
    return path if path.is_file() else None


def test_every_quoted_command_exists() -> None:
    problems = [problem for quoted in (*OURS, *SENTENCES) if (problem := problem_of(quoted))]
    assert not problems, "\n".join(problems)


def check_settings(package: str, settings: list[str], trajectory: Path | None = None) -> None:
    """Raise if the files of a command do not have one of its `--set` keys."""
    if package == "reconstruct":
        from koala3d.reconstruct.models import load_config

        load_config("surfnerf", "fast", settings)
    elif package == "capture" and settings:
        from koala3d.capture.model.trajectory import load_trajectory

        path = shipped(Path(trajectory or "TRAJECTORY"))
        assert path is not None, f"{trajectory} does not exist"
        load_trajectory(path, overrides=settings)


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


WRONG = (
    "reconstruct train SCENE --out RUN --budgt 3",
    "reconstruct trian SCENE --out RUN",
    "reconstruct train --out",
    "calib handeye REC",
    "datasets export SCENE --out X",
    "reconstruct mesh RUN --out M --resolution many",
    "capture --dbg run T",
)


def test_a_wrong_command_is_noticed() -> None:
    for words in WRONG:
        assert problem_of(Quoted(ROOT / "README.md", 1, tuple(words.split()), False)), words


def test_a_wrong_setting_is_noticed() -> None:
    with pytest.raises(KoalaError, match="did you mean"):
        check_settings("reconstruct", ["train.rat=0.1"])
    with pytest.raises(KoalaError, match="did you mean"):
        check_settings("capture", ["motion.sped=0.3"])


def test_arguments_of_other_programs_exist() -> None:
    """Targets of make and extras of pip. Any other program in a shell block has to be listed here."""
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M))
    extras = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    for page in PAGES:
        text = page.read_text()
        assert set(re.findall(r"(?:`|^    )make ([a-z-]+)", text, re.M)) <= targets, page.name
        assert set(re.findall(r"'(?:\.|koala-capture)\[(\w+)\]'", text)) <= extras, page.name
    for quoted in BLOCKS:
        assert quoted.words[0] in (*PACKAGES, "colmap", "mkdir", "ssh", "pip", "python", "make"), str(quoted)


def test_there_are_at_most_52_commands_and_85_settings() -> None:
    """More would hide the ones that matter: a new one takes the place of another, or becomes an option or a default.

    The 49th, `calib export`, makes nothing new of a calibration and so is no option of a command that does. The 50th,
    `reconstruct splats`, shares no option with the meshes and assets of a run but its output. The 51st, `reconstruct series`,
    runs the commands of all four steps, where a sweep trains. The 52nd, `reconstruct compare-shape`, takes two shapes where all
    others take one run or scene.
    """
    shown = [name for package in PACKAGES for name, one in command_line(package).commands.items() if not one.hidden]
    assert len(shown) <= 52, shown
    assert len(settings(load_config())) <= 85


def test_every_command_is_in_a_panel() -> None:
    assert all(
        one.hidden or one.rich_help_panel in PANELS for package in PACKAGES for one in command_line(package).commands.values()
    )


def test_a_command_runs_as_a_module_too() -> None:
    """For when the command is not on the PATH; exiting silently would be worse than failing."""
    for package in PACKAGES:
        done = subprocess.run(
            [sys.executable, "-m", f"koala3d.{package}.cli", "--help"], capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0 and done.stdout.startswith("Usage:"), package


SMALLER = {
    "calibration_demo": ("camera.binning=3", "camera.width=640", "camera.height=360"),
    "koala_demo": ("views.0.count=15", "split={train: 12, test: 3}"),
}
"""Settings that make the tutorial's recordings small, by trajectory."""
SHORTER = {"train": ("--budget", "45"), "mesh": ("--resolution", "48", "--level", "0.1")}
"""Options that make its training short, and find a surface in a model that was trained so little."""


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_the_tutorial_leads_to_a_mesh(tmp_path: Path) -> None:
    """Run every command of the tutorial in its order in an empty folder, with smaller and fewer pictures.

    Pages in the browser are opened and ended with Ctrl-C, as a reader would."""
    tutorial = [quoted for quoted in BLOCKS if quoted.page.name == "tutorial.md" and quoted.words[0] in PACKAGES]
    commands = [quoted.words[1] for quoted in tutorial if quoted.words[0] == "reconstruct"]
    assert commands == ["train", "view", "eval", "report", "mesh"]
    (tmp_path / "tutorial").mkdir()
    for quoted in tutorial:
        if quoted.words[1:] == ("--help",):
            continue
        settings = [
            word for name, values in SMALLER.items() if name in quoted.words for value in values for word in ("--set", value)
        ]
        options = [word for name, words in SHORTER.items() if name in quoted.words for word in words]
        command = [sys.executable, "-m", f"{quoted.words[0]}.cli", *quoted.words[1:], *settings, *options]
        if quoted.words[1] == "view":
            open_page(command, tmp_path)
            continue
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, f"{quoted}: {done.stderr}"
    assert (tmp_path / "tutorial" / "mesh.ply").stat().st_size > 1000
    assert "<table" in (tmp_path / "tutorial" / "report" / "index.html").read_text()


def open_page(command: list[str], folder: Path) -> None:
    """Start a command that serves a page, check that it is served, and end it with Ctrl-C."""
    process = subprocess.Popen([*command, "--port", "0", "--json"], cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        with urllib.request.urlopen(json.loads(process.stdout.readline())["url"], timeout=60) as answer:
            assert b"<html" in answer.read(4096).lower()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0
    finally:
        process.kill()
