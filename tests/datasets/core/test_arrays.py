import io
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core import arrays
from koala3d.datasets.core.errors import DatasetError, UsageError


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3),
        np.zeros((0, 17)),
        np.float32(3),
        np.array(["a", "bc"]),
        np.asfortranarray(np.arange(6).reshape(2, 3)),
    ],
)
def test_plain_arrays_come_back(tmp_path: Path, array: np.ndarray) -> None:
    np.save(tmp_path / "a.npy", array)
    assert np.array_equal(arrays.read_npy(tmp_path / "a.npy"), array)
    np.savez_compressed(tmp_path / "a.npz", one=array, two=array)
    found = arrays.read_npz(tmp_path / "a.npz", ("t",))
    assert list(found) == ["two"] and np.array_equal(found["two"], array)


def test_a_missing_file_is_a_usage_error(tmp_path: Path) -> None:
    for read, name in ((arrays.read_npy, "a.npy"), (arrays.read_npz, "a.npz")):
        with pytest.raises(UsageError, match="no such file"):
            read(tmp_path / name)


class Trap:
    """Would make a folder where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return (Path.mkdir, (self.path,))


def test_nothing_is_unpickled(tmp_path: Path) -> None:
    trap = np.array([Trap(tmp_path / "sprung")], dtype=object)
    np.save(tmp_path / "a.npy", trap, allow_pickle=True)
    np.savez(tmp_path / "a.npz", trap=trap)
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
    for read, name in ((arrays.read_npy, "a.npy"), (arrays.read_npy, "b.npy"), (arrays.read_npz, "a.npz")):
        with pytest.raises(DatasetError):
            read(tmp_path / name)
    assert not (tmp_path / "sprung").exists()
    pickle.loads((tmp_path / "b.npy").read_bytes())
    assert (tmp_path / "sprung").exists()  # the premise: the trap works


def test_headers_that_claim_more_than_the_file_holds(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((4, 17)))
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data.replace(b"(4, 17)", b"(9999999999, 17)").replace(b" " * 12, b" " * 3, 1))
    with pytest.raises(DatasetError, match="is cut off"):
        arrays.read_npy(tmp_path / "a.npy")


def test_archives_that_unpack_to_too_many_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrays, "MAX_BYTES", 10_000)
    np.savez_compressed(tmp_path / "a.npz", big=np.zeros(2000))
    assert (tmp_path / "a.npz").stat().st_size < 1000  # the premise
    with pytest.raises(DatasetError, match="unpacks to too much"):
        arrays.read_npz(tmp_path / "a.npz")


def test_an_archive_with_wrong_sizes(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(50))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", buffer.getvalue())
    data = bytearray((tmp_path / "a.npz").read_bytes())
    size = len(buffer.getvalue()).to_bytes(4, "little")
    (tmp_path / "a.npz").write_bytes(bytes(data).replace(size, (10**6).to_bytes(4, "little")))
    with pytest.raises(DatasetError, match="not a file of plain arrays"):
        arrays.read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize(("array", "shape", "good"), [
    (np.zeros((3, 4)), (None, 4), True), (np.zeros((3, 4), int), (3, 4), True), (np.zeros((3, 5)), (None, 4), False),
    (np.zeros(4), (None, 4), False), (np.zeros((3, 4), complex), (None, 4), False), (np.array([["a"] * 4]), (None, 4), False),
])  # fmt: skip
def test_numbers(array: np.ndarray, shape: tuple, good: bool) -> None:
    if good:
        assert arrays.numbers(array, shape, where="x").dtype == np.float64
    else:
        with pytest.raises(DatasetError, match=r"does not hold n x 4 numbers"):
            arrays.numbers(array, shape, where="x")
