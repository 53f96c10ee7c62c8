import os
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import copies, images
from koala3d.datasets.imaging.copies import Copies

RANDOM = np.random.default_rng(0)
PICTURE = RANDOM.random((6, 8, 3), np.float32)
Make = Callable[[], NDArray[Any]]


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A file whose picture is kept; what is in it does not matter."""
    path = tmp_path / "a.jpg"
    path.write_bytes(b"a picture")
    return path


class Counted:
    """Makes the picture, and counts how often."""

    def __init__(self, picture: NDArray[Any] = PICTURE) -> None:
        self.picture, self.count = picture, 0

    def __call__(self) -> NDArray[Any]:
        self.count += 1
        return self.picture


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float16, np.float32])
def test_a_picture_is_made_once_and_mapped_afterwards(tmp_path: Path, source: Path, kind: Any) -> None:
    picture = (PICTURE * 200).astype(kind)
    kept, make = Copies(tmp_path / "kept"), Counted(picture)
    for _ in range(3):
        found = kept.of([source], 8, 6, make)
        assert found.dtype == kind
        np.testing.assert_array_equal(found, picture)
    assert make.count == 1 and isinstance(found, np.memmap) and not found.flags.writeable


def test_each_size_and_each_mask_has_its_own_copy(tmp_path: Path, source: Path) -> None:
    mask = tmp_path / "m.png"
    mask.write_bytes(b"a mask")
    kept, make = Copies(tmp_path / "kept"), Counted()
    kept.of([source], 8, 6, make)
    kept.of([source], 4, 3, lambda: make()[:3, :4])
    kept.of([source, mask], 8, 6, make)
    kept.of([source, mask], 8, 6, make, how="black is the object")
    assert make.count == 4 and len(list((tmp_path / "kept").iterdir())) == 4
    assert kept.of([source], 4, 3, make).shape == (3, 4, 3) and make.count == 4


@pytest.mark.parametrize("change", ["time", "size"])
def test_a_changed_source_replaces_its_copy(tmp_path: Path, source: Path, change: str) -> None:
    kept, make = Copies(tmp_path / "kept"), Counted()
    kept.of([source], 8, 6, make)
    if change == "size":
        source.write_bytes(b"another picture")
    os.utime(source, ns=(0, 1 if change == "time" else source.stat().st_mtime_ns))
    make.picture = PICTURE + 1
    np.testing.assert_array_equal(kept.of([source], 8, 6, make), PICTURE + 1)
    assert make.count == 2 and len(list((tmp_path / "kept").iterdir())) == 1, "the old one is of no use"


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-9])


def flip(place: int) -> Callable[[Path], None]:
    """Changes one bit; negative places count from the end."""

    def damage(path: Path) -> None:
        data = bytearray(path.read_bytes())
        data[place] ^= 1
        path.write_bytes(data)

    return damage


def transposed(path: Path) -> None:
    """The header says 8x6 instead of 6x8."""
    path.write_bytes(path.read_bytes().replace(b"(6, 8, 3)", b"(8, 6, 3)"))


def as_objects(path: Path) -> None:
    """The header asks for pickled objects."""
    path.write_bytes(path.read_bytes().replace(b"'<f4'", b"'|O' "))


@pytest.mark.parametrize(
    "damage", [cut_off, flip(3), flip(200), flip(-1), transposed, as_objects, lambda path: path.write_bytes(b"")]
)
def test_a_damaged_copy_is_made_again(tmp_path: Path, source: Path, damage: Callable[[Path], None]) -> None:
    kept, make = Copies(tmp_path / "kept"), Counted()
    kept.of([source], 8, 6, make)
    (copy,) = (tmp_path / "kept").iterdir()
    before = copy.read_bytes()
    damage(copy)
    assert copy.read_bytes() != before and copies.mapped(copy) is None
    np.testing.assert_array_equal(kept.of([source], 8, 6, make), PICTURE)
    assert make.count == 2 and copy.read_bytes() == before


def test_a_folder_that_cannot_be_written_does_no_harm(tmp_path: Path, source: Path) -> None:
    (tmp_path / "kept").write_text("a file is in the way")
    make = Counted()
    for _ in range(2):
        np.testing.assert_array_equal(Copies(tmp_path / "kept").of([source], 8, 6, make), PICTURE)
    assert make.count == 2


def test_a_disk_that_is_nearly_full_is_left_alone(tmp_path: Path, source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(copies.shutil, "disk_usage", lambda _: usage(2**40, 2**40 - copies.ROOM, copies.ROOM))
    Copies(tmp_path / "kept").of([source], 8, 6, Counted())
    assert not list((tmp_path / "kept").iterdir())


def test_a_missing_source_is_reported_by_who_reads_it(tmp_path: Path) -> None:
    missing = tmp_path / "none.png"
    with pytest.raises(UsageError, match="no such image"):
        Copies(tmp_path / "kept").of([missing], 8, 6, lambda: images.read_stored(missing))
