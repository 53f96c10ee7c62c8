import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, OSError])
def test_an_interrupted_file_leaves_the_old_one(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "a.json"
    files.write_json(path, {"old": 1})
    with pytest.raises(error), files.atomic_path(path) as temporary:
        temporary.write_text("half")
        raise error
    assert files.read_json(path) == {"old": 1} and [p.name for p in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_interrupted_folder_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error), files.atomic_folder(tmp_path / "scene") as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "a").write_text("half")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_a_killed_writer_leaves_no_half_file_under_the_name(tmp_path: Path) -> None:
    """SIGKILL gives no chance to tidy up, so what counts is that the name itself is never half written."""
    code = (
        "import sys, time; from koala3d.datasets.core import files\n"
        f"with files.atomic_path({str(tmp_path / 'a.bin')!r}) as t:\n"
        "    t.write_bytes(b'x' * 1000); print('half', flush=True); time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert process.stdout is not None and process.stdout.readline() == b"half\n"
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (tmp_path / "a.bin").exists()


def test_an_interrupted_folder_writer_cleans_up(tmp_path: Path) -> None:
    code = (
        "import signal, time; from koala3d.datasets.core import files\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"with files.atomic_folder({str(tmp_path / 'scene')!r}) as f:\n"
        "    (f / 'a').write_bytes(b'x'); print('half', flush=True); time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None and process.stdout.readline() == b"half\n"
    process.send_signal(signal.SIGINT)
    process.wait()
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    with files.atomic_folder(tmp_path / "scene") as folder:  # an empty folder may be filled
        (folder / "a").write_text("1")
    with pytest.raises(UsageError, match="already exists"), files.atomic_folder(tmp_path / "scene"):
        pass
    assert (tmp_path / "scene" / "a").read_text() == "1"


@pytest.mark.parametrize("name", ["../a", "/etc/passwd", "sub/../../a", "..", "sub/../.."])
def test_paths_stay_inside_their_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(DatasetError, match="leaves the folder"):
        files.inside(tmp_path / "scene", name)
    with pytest.raises(DatasetError, match="leaves the folder"):
        files.target(tmp_path / "scene", name)
    assert files.inside(tmp_path / "scene", "sub/a") == tmp_path / "scene" / "sub" / "a"


def test_a_link_in_a_folder_is_read_through_and_never_written_through(tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "images").symlink_to(tmp_path)
    assert files.inside(tmp_path / "scene", "images/a") == tmp_path / "scene" / "images" / "a"
    assert files.inside(tmp_path / "scene", "images/../a") == tmp_path / "scene" / "a"  # beside the link, not beside its target
    with pytest.raises(DatasetError, match="through a link"):
        files.target(tmp_path / "scene", "images/a")


@pytest.mark.parametrize("name", ["a\0b", "x" * 256, "\ud800", 7, None])
def test_what_cannot_name_a_file_is_refused(tmp_path: Path, name: object) -> None:
    with pytest.raises(DatasetError, match="is not usable"):
        files.inside(tmp_path, name)  # type: ignore[arg-type]


def test_json_checks_kind_and_version(tmp_path: Path) -> None:
    files.write_json(tmp_path / "a", {"format": "one", "version": 2, "array": np.arange(2)})
    assert files.read_json(tmp_path / "a", kind="one", version=2)["array"] == [0, 1]
    with pytest.raises(DatasetError, match="version 2 cannot be read"):
        files.read_json(tmp_path / "a", kind="one", version=1)
    with pytest.raises(DatasetError, match="is not a two file"):
        files.read_json(tmp_path / "a", kind="two", version=2)
    with pytest.raises(ValueError, match="not JSON compliant"):
        files.write_json(tmp_path / "b", {"x": np.nan})
    assert not (tmp_path / "b").exists()
    with pytest.raises(UsageError, match="no such file"):
        files.read_json(tmp_path / "none")
    (tmp_path / "c").write_bytes(b"\xff{")
    with pytest.raises(DatasetError, match="not a text file"):
        files.read_json(tmp_path / "c")


def test_a_written_file_can_be_read_by_others(tmp_path: Path) -> None:
    files.write_text(tmp_path / "a", "x")
    assert os.stat(tmp_path / "a").st_mode & 0o777 == 0o644


def test_a_missing_file_suggests_the_nearest_name(tmp_path: Path) -> None:
    files.write_json(tmp_path / "calibration.json", {})
    with pytest.raises(UsageError, match=r"no such file; did you mean 'calibration.json'\?"):
        files.read_json(tmp_path / "calibratio.json")
    with pytest.raises(UsageError, match=r"valid: calibration\.json"):
        files.read_json(tmp_path / "x.json")
    with pytest.raises(UsageError, match="there is no folder"):
        files.read_json(tmp_path / "nowhere" / "x.json")
    for index in range(files.MOST_LISTED):
        files.write_json(tmp_path / f"{index}.json", {})
    with pytest.raises(UsageError, match="check the path"):
        files.read_json(tmp_path / "run_of_mine.json")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_text_is_read_without_its_byte_order_mark(tmp_path: Path, encoding: str) -> None:
    """Excel and PowerShell write one; PowerShell's `>` writes UTF-16."""
    (tmp_path / "a.json").write_text('{"name": "Süd"}', encoding=encoding)
    assert files.read_json(tmp_path / "a.json") == {"name": "Süd"}
