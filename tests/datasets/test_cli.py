"""The command as a person meets it: output, exit codes 0, 1 and 2, one line on errors."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from koala3d.datasets.cli import main
from koala3d.datasets.formats import SIZED, WRITERS, koala
from koala3d.datasets.scene import Scene


def command(*arguments: object, before: str = "pass") -> list[str]:
    """What a shell would start, the Python statement `before` first."""
    return [sys.executable, "-c", f"{before}\nfrom koala3d.datasets.cli import main; main()", *map(str, arguments)]


Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def run(run_inside: Run) -> Run:
    """Runs the command inside this process."""
    return partial(run_inside, main, "datasets")


@pytest.fixture
def saved(make_scene: Callable[..., Scene], tmp_path: Path) -> Path:
    koala.save(make_scene(), tmp_path / "koala" / "little")
    return tmp_path / "koala" / "little"


def test_info_as_text_and_json(run: Run, saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = run("info", saved)
    assert text.returncode == 0 and "6 train, 3 test; 96x72 px" in text.stdout and "near, far" in text.stdout
    monkeypatch.setenv("KOALA_DATA", str(saved.parent.parent))
    found = json.loads(run("info", "koala/little", "--json").stdout)
    assert found["views"]["train"] == 6 and found["far"] is None


@pytest.mark.parametrize("layout", ["blender", "llff"])
def test_export_says_what_is_lost_and_never_overwrites(run: Run, saved: Path, tmp_path: Path, layout: str) -> None:
    done = run("export", saved, "--format", layout, "--out", tmp_path / "out", "--json")
    assert done.returncode == 0 and json.loads(done.stdout)["views"] == 9 and "koala.json" in json.loads(done.stdout)["limits"]
    assert run("check", tmp_path / "out").stdout == "nothing is wrong\n"
    again = run("export", saved, "--format", layout, "--out", tmp_path / "out")
    assert again.returncode == 2 and "already exists" in again.stderr


def in_process(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict:
    """What a command prints as JSON, without a new interpreter."""
    from koala3d.datasets.cli import app

    app([*map(str, arguments), "--json"], standalone_mode=False)
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("layout", [name for name in WRITERS if name != "koala"])
def test_export_reaches_every_layout_and_comes_back(
    saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], layout: str
) -> None:
    sizes = ["--sizes", "2,4"] if layout in SIZED else []
    assert in_process(capsys, "export", saved, "--format", layout, "--out", tmp_path / "out", *sizes)["views"] == 9
    source = layout.replace("-text", "").replace("mipnerf360", "colmap")
    back = in_process(capsys, "export", tmp_path / "out", "--from", source, "--format", "koala", "--out", tmp_path / "back")
    assert back["views"] == 9 and back["limits"] == ""
    assert bool(sizes) == (tmp_path / "out" / "images_4").is_dir() or layout == "mipnerf360"


def test_scenes_from_scenes(saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def done(*arguments: object) -> dict:
        return in_process(capsys, *arguments)

    assert done("edit", saved, "--every", 2, "--out", tmp_path / "a")["views"] == {"train": 2, "val": 0, "test": 3}
    assert done("edit", saved, "--splits", "train", "--out", tmp_path / "b")["views"] == {"train": 6, "val": 0, "test": 0}
    assert done("edit", saved, "--hold-out", 3, "--out", tmp_path / "c")["views"] == {"train": 6, "val": 0, "test": 3}
    assert done("merge", tmp_path / "a", tmp_path / "b", "--out", tmp_path / "d")["views"] == {"train": 8, "val": 0, "test": 3}
    assert done("edit", saved, "--downscale", 3, "--out", tmp_path / "e")["sizes"] == [[32, 24]]
    assert done("edit", saved, "--undistort", "--out", tmp_path / "f")["sizes"] == [[96, 72]]
    assert done("edit", saved, "--crop", 8, 4, 50, 40, "--out", tmp_path / "g")["sizes"] == [[50, 40]]
    several = ["--every", 3, "--test", "00[36]", "--downscale", 2, "--crop", 8, 4, 50, 40]
    found = done(
        "edit", saved, *several, "--out", tmp_path / "h"
    )  # cut first, then made smaller, in whatever order it is asked for
    assert found["sizes"] == [[25, 20]] and found["views"] == {"train": 1, "val": 0, "test": 2}
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]  # nothing temporary is left
    from koala3d.datasets.core.errors import UsageError

    for wrong in (("edit", saved, "--splits", "exam"), ("export", saved, "--format", "koala", "--sizes", "2,x")):
        with pytest.raises(UsageError):
            done(*wrong, "--out", tmp_path / "i")


def test_names_are_looked_up_in_the_data_root_first(saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.formats import find

    for root in ("root", "here", "env"):
        (tmp_path / root / "koala" / "x").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("KOALA_DATA", str(tmp_path / "env"))
    assert find("koala/x", tmp_path / "root") == tmp_path / "root" / "koala" / "x"
    assert find("koala/x").resolve() == tmp_path / "here" / "koala" / "x"
    (tmp_path / "here" / "koala" / "x").rmdir()
    assert find("koala/x") == tmp_path / "env" / "koala" / "x"
    (tmp_path / "here" / "koala" / "gold_head").mkdir()
    with pytest.raises(UsageError, match="did you mean 'gold_head'"):
        find("koala/gold_hed")


def test_check_fails_where_something_is_wrong(run: Run, saved: Path) -> None:
    (saved / "images" / "001.png").unlink()
    failed = run("check", saved)
    assert failed.returncode == 1 and "001.png: no such image" in failed.stdout and "1 errors, 0 warnings" in failed.stdout
    assert json.loads(run("check", saved, "--json").stdout)["errors"] == 1


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("info", "nowhere/at/all"), 2, "no such scene"),
        (("info",), 2, "SCENE"),
        (("export", "{scene}", "--format", "lff", "--out", "x"), 2, "did you mean 'llff'"),
        (("build", "{scene}", "--calibration", "none.json", "--out", "x"), 2, "is not a recording"),
        (("inf",), 2, "inf"),
    ],
)
def test_a_usage_error_is_one_line_and_exit_code_2(
    run: Run, saved: Path, arguments: tuple[str, ...], code: int, words: str
) -> None:
    failed = run(*(argument.format(scene=saved) for argument in arguments))
    assert failed.returncode == code and words in failed.stderr
    assert len(failed.stderr.strip().splitlines()) == 1 and "Traceback" not in failed.stderr


def test_a_broken_file_is_one_line_and_exit_code_1(run: Run, saved: Path) -> None:
    (saved / "cameras.json").write_text("{")
    failed = run("info", saved)
    assert failed.returncode == 1 and "not valid JSON" in failed.stderr and len(failed.stderr.strip().splitlines()) == 1


def test_a_full_disk_is_one_line_and_leaves_nothing(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    """Writes are limited to 2 kB a file; the signal that the system sends is ignored, so that the write fails instead."""
    from koala3d.datasets.camera_model import Camera

    koala.save(make_scene(Camera(96, 72, 90.0, 91.0, 50.0, 34.0, k1=-0.1)), tmp_path / "scene")
    small_files = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))"
    )
    words = command("export", tmp_path / "scene", "--format", "blender", "--out", tmp_path / "o" / "x", before=small_files)
    failed = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert failed.returncode == 1 and "Traceback" not in failed.stderr and "error:" in failed.stderr
    assert list((tmp_path / "o").iterdir()) == []


def test_ctrl_c_is_one_line_and_leaves_nothing(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    from koala3d.datasets.camera_model import Camera

    koala.save(make_scene(Camera(320, 240, 300.0, 301.0, 160.0, 120.0, k1=-0.1), 40, truth=False), tmp_path / "scene")
    started = command(
        "export",
        tmp_path / "scene",
        "--format",
        "llff",
        "--out",
        tmp_path / "o" / "x",
        before="import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)",  # as shells start background jobs
    )
    process = subprocess.Popen(started, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list((tmp_path / "o").glob(".x.*/images/*.png")) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1 and errors.startswith("error: stopped by Ctrl-C") and len(errors.strip().splitlines()) == 1
    assert list((tmp_path / "o").iterdir()) == []


def test_the_documentation_names_commands_and_options_that_exist() -> None:
    import typer

    from koala3d.datasets.cli import app

    group = typer.main.get_command(app)
    text = (Path(__file__).parents[2] / "docs" / "datasets.md").read_text()
    lines = [line.strip().split() for line in text.splitlines() if line.startswith("    datasets ")]
    assert len(lines) >= 10
    for _, name, *words in lines:
        known = {option for parameter in group.commands[name].params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= known, name
    shown = {words[1] for words in lines} | {"truth"}
    assert shown == set(group.commands)  # nothing is left out
