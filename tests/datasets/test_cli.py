"""The command as a person meets it: output, exit codes 0, 1 and 2, one line on errors."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from datasets.formats import koala
from datasets.scene import Scene


def command(*arguments: object, before: str = "pass") -> list[str]:
    """What a shell would start, the Python statement `before` first."""
    return [sys.executable, "-c", f"{before}\nfrom datasets.cli import main; main()", *map(str, arguments)]


def run(*arguments: object, before: str = "pass", **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments, before=before), capture_output=True, text=True, timeout=120,
                          env={**os.environ, **environment}, check=False)  # fmt: skip


@pytest.fixture
def saved(make_scene: Callable[..., Scene], tmp_path: Path) -> Path:
    koala.save(make_scene(), tmp_path / "koala" / "little")
    return tmp_path / "koala" / "little"


def test_help_is_instant_and_names_the_commands() -> None:
    run("--help")
    start = time.perf_counter()
    shown = run("--help")
    assert time.perf_counter() - start < 1.0  # 0.1 s on an idle core; a heavy import alone takes longer than this
    assert shown.returncode == 0 and all(command in shown.stdout for command in ("build", "info", "check", "export"))


def test_info_for_a_person_and_for_a_program(saved: Path) -> None:
    text = run("info", saved)
    assert text.returncode == 0 and "6 train, 3 test; 96x72 px" in text.stdout and "near, far" in text.stdout
    found = json.loads(run("info", "koala/little", "--json", KOALA_DATA=str(saved.parent.parent)).stdout)
    assert found["views"]["train"] == 6 and found["far"] is None


@pytest.mark.parametrize("layout", ["blender", "llff"])
def test_export_says_what_is_lost_and_never_overwrites(saved: Path, tmp_path: Path, layout: str) -> None:
    done = run("export", saved, "--format", layout, "--out", tmp_path / "out", "--json")
    assert done.returncode == 0 and json.loads(done.stdout)["views"] == 9 and "koala.json" in json.loads(done.stdout)["limits"]
    assert run("check", tmp_path / "out").stdout == "nothing is wrong\n"
    again = run("export", saved, "--format", layout, "--out", tmp_path / "out")
    assert again.returncode == 2 and "already exists" in again.stderr


def test_check_fails_where_something_is_wrong(saved: Path) -> None:
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
def test_misuse_is_one_line_and_exit_code_2(saved: Path, arguments: tuple[str, ...], code: int, words: str) -> None:
    failed = run(*(argument.format(scene=saved) for argument in arguments))
    assert failed.returncode == code and words in failed.stderr
    assert len(failed.stderr.strip().splitlines()) == 1 and "Traceback" not in failed.stderr


def test_a_broken_file_is_one_line_and_exit_code_1(saved: Path) -> None:
    (saved / "cameras.json").write_text("{")
    failed = run("info", saved)
    assert failed.returncode == 1 and "not valid JSON" in failed.stderr and len(failed.stderr.strip().splitlines()) == 1


def test_a_full_disk_is_one_line_and_leaves_nothing(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    """Writes are limited to 2 kB a file; the signal that the system sends is ignored, so that the write fails instead."""
    from datasets.camera_model import Camera

    koala.save(make_scene(Camera(96, 72, 90.0, 91.0, 50.0, 34.0, k1=-0.1)), tmp_path / "scene")
    small_files = ("import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
                   "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))")  # fmt: skip
    failed = run("export", tmp_path / "scene", "--format", "blender", "--out", tmp_path / "o" / "x", before=small_files)
    assert failed.returncode == 1 and "Traceback" not in failed.stderr and "error:" in failed.stderr
    assert list((tmp_path / "o").iterdir()) == []


def test_ctrl_c_is_one_line_and_leaves_nothing(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    from datasets.camera_model import Camera

    koala.save(make_scene(Camera(320, 240, 300.0, 301.0, 160.0, 120.0, k1=-0.1), 40, truth=False), tmp_path / "scene")
    started = command("export", tmp_path / "scene", "--format", "llff", "--out", tmp_path / "o" / "x",
                      before="import signal; signal.signal(signal.SIGINT, signal.default_int_handler)")  # fmt: skip
    process = subprocess.Popen(started, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list((tmp_path / "o").glob(".x.*/images/*.png")) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1 and errors.startswith("error: stopped by Ctrl-C") and len(errors.strip().splitlines()) == 1
    assert list((tmp_path / "o").iterdir()) == []
