import shutil
from pathlib import Path

import pytest

from koala3d.datasets.core.budgets import readable, require_room
from koala3d.datasets.core.errors import KoalaError


def test_room_is_asked_of_the_disk_that_will_hold_the_folder(tmp_path: Path) -> None:
    require_room(tmp_path / "new" / "run", 1e3, "the run")
    free = shutil.disk_usage(tmp_path).free
    with pytest.raises(KoalaError, match=r"run: the disk has no room for the run \(up to .* needed, .* free\); free some space"):
        require_room(tmp_path / "new" / "run", free + 1e9, "the run")
    assert not (tmp_path / "new").exists()


def test_a_path_relative_to_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(KoalaError, match=r"^run: "):
        require_room(Path("run"), 1e18, "it")


@pytest.mark.parametrize(("size", "words"), [(0, "0.0 kB"), (2e5, "200.0 kB"), (1.26e6, "1.3 MB"), (3.2e9, "3.2 GB")])
def test_sizes_are_readable(size: float, words: str) -> None:
    assert readable(size) == words
