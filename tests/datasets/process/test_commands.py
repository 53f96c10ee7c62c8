"""The command line: what it prints, what it refuses, and in which words."""

import io
import json
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest

pytest.importorskip("pycolmap")

from koala3d.datasets.cli import app
from koala3d.datasets.core.errors import UsageError


def run(*words: object) -> None:
    app(["process", *map(str, words)], standalone_mode=False)


@pytest.fixture(scope="module")
def made(shots, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """(the scene of the photographs, what the command printed)."""
    out, printed = tmp_path_factory.mktemp("made") / "scene", io.StringIO()
    with redirect_stdout(printed):
        run(shots.folder, "--out", out, "--json")
    return out, printed.getvalue()


def test_a_scene_is_made_and_described(made, shots) -> None:
    out, facts = made[0], json.loads(made[1])
    assert facts["scene"] == str(out) and facts["pictures"] == facts["placed"] == 10 and facts["groups"] == [10]
    assert facts["left_out"] == {} and facts["metric"] is False and facts["scale_from"] is None
    assert "4X4_1000 7" in facts["hint"] and "--marker-mm" in facts["hint"]
    assert (out / "cameras.json").is_file() and len(list((out / "images").iterdir())) == 10
    with pytest.raises(UsageError, match="already exists"):
        run(shots.folder, "--out", out)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("--up down", "--up: cannot be 'down'"),
        ("--match al", "--match: cannot be 'al'; did you mean 'all'?"),
        ("--cameras two", "--cameras: cannot be 'two'"),
        ("--marker-mm 0", "a marker's side must be positive"),
        ("--marker-mm 9 --positions a.txt", "the size is stated twice"),
        ("--known-length a:1,2 b:3,4 0.1", "does not name a point"),
        ("--vocabulary none.bin", "none.bin: no such file"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_done(shots, tmp_path: Path, words: str, complaint: str) -> None:
    with pytest.raises(UsageError) as error:
        run(shots.folder, *words.split(), "--out", tmp_path / "out")
    assert complaint in str(error.value) and not list(tmp_path.iterdir())


def test_a_file_in_place_of_the_work_is_not_touched(shots, tmp_path: Path) -> None:
    (tmp_path / "out.work").mkdir()
    (tmp_path / "out.work" / "thesis.txt").write_text("precious")
    with pytest.raises(UsageError, match="is in the way"):
        run(shots.folder, "--out", tmp_path / "out")
    assert (tmp_path / "out.work" / "thesis.txt").read_text() == "precious"


def test_without_the_library_nothing_begins(shots, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(ModuleNotFoundError) as error:
        run(shots.folder, "--out", tmp_path / "out")
    assert error.value.name == "pycolmap" and not list(tmp_path.iterdir())


def test_a_scene_is_compared_with_a_reference(made, capsys: pytest.CaptureFixture[str]) -> None:
    app(["compare", str(made[0]), str(made[0]), "--json"], standalone_mode=False)
    found = json.loads(capsys.readouterr().out)
    assert found["views"] == 10 and found["position"]["largest"] < 1e-6 and found["direction"]["largest"] < 1e-4
