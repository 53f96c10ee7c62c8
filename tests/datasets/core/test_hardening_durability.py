"""What is written survives a power cut: files and the folders that name them are flushed."""

import os
from pathlib import Path

import pytest

from koala3d.datasets.core import files


class Flushes:
    """The order of renames and flushes, each as ("replace" or "fsync", path)."""

    def __init__(self, patched: pytest.MonkeyPatch) -> None:
        self.calls: list[tuple[str, Path]] = []
        fsync, replace = os.fsync, os.replace

        def noted_fsync(descriptor: int) -> None:
            self.calls.append(("fsync", Path(os.readlink(f"/proc/self/fd/{descriptor}"))))
            fsync(descriptor)

        def noted_replace(source: str | Path, target: str | Path) -> None:
            self.calls.append(("replace", Path(target)))
            replace(source, target)

        patched.setattr(os, "fsync", noted_fsync)
        patched.setattr(os, "replace", noted_replace)


@pytest.fixture
def flushes(monkeypatch: pytest.MonkeyPatch) -> Flushes:
    if not Path("/proc/self/fd").exists():
        pytest.skip("open files are watched through /proc: there is none")
    return Flushes(monkeypatch)


def test_a_folder_is_flushed_after_a_file_was_renamed_into_it(flushes: Flushes, tmp_path: Path) -> None:
    files.write_json(tmp_path / "a.json", {})
    renamed = flushes.calls.index(("replace", tmp_path / "a.json"))
    assert ("fsync", tmp_path) in flushes.calls[renamed:]


def test_new_parent_folders_are_flushed(flushes: Flushes, tmp_path: Path) -> None:
    files.write_json(tmp_path / "b" / "c" / "a.json", {})
    flushed = {path for call, path in flushes.calls if call == "fsync"}
    assert {tmp_path, tmp_path / "b", tmp_path / "b" / "c"} <= flushed


def test_a_folder_that_is_renamed_as_a_whole_is_flushed_with_everything_in_it(flushes: Flushes, tmp_path: Path) -> None:
    with files.atomic_folder(tmp_path / "scene") as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "a").write_text("1")
    renamed = flushes.calls.index(("replace", tmp_path / "scene"))
    before = {path.name for call, path in flushes.calls[:renamed] if call == "fsync"}
    assert {"a", "sub"} <= before and ("fsync", tmp_path) in flushes.calls[renamed:]
