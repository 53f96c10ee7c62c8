import errno
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging import images

RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize(("suffix", "kind"), [(".png", np.uint8), (".png", np.uint16), (".tif", np.uint16)])
def test_integers_come_back_as_they_were_alpha_straight(tmp_path: Path, suffix: str, kind: type, channels: int) -> None:
    top = np.iinfo(kind).max
    given_ = RANDOM.integers(0, top, (7, 11, channels), kind, endpoint=True)
    images.write(tmp_path / f"a{suffix}", given_)
    back = images.read(tmp_path / f"a{suffix}")
    assert back.dtype == np.float32 and back.shape == given_.shape
    assert np.array_equal(np.round(back.astype(np.float64) * top), given_)
    assert images.size(tmp_path / f"a{suffix}") == (11, 7) and images.channels(tmp_path / f"a{suffix}") == channels
    theirs = cv2.imread(str(tmp_path / f"a{suffix}"), cv2.IMREAD_UNCHANGED)
    assert theirs is not None and theirs.dtype == kind
    order = {1: [0], 3: [2, 1, 0], 4: [2, 1, 0, 3]}[channels]  # OpenCV has blue first
    assert np.array_equal(theirs.reshape(given_.shape)[..., order], given_)


@pytest.mark.parametrize(("suffix", "channels"), [(".exr", 1), (".exr", 3), (".tif", 1), (".tif", 3), (".tif", 4)])
def test_floats_come_back_to_the_bit(tmp_path: Path, suffix: str, channels: int) -> None:
    given_ = RANDOM.normal(0, 100, (5, 6, channels)).astype(np.float32)
    images.write(tmp_path / f"a{suffix}", given_)
    assert np.array_equal(images.read(tmp_path / f"a{suffix}"), given_)


def test_float_in_png_is_rounded_and_clipped(tmp_path: Path) -> None:
    images.write(tmp_path / "a.png", np.array([[-1.0, 0.5 / 255 + 1e-4, 2.0]]))
    assert np.allclose(images.read(tmp_path / "a.png").ravel() * 255, [0, 1, 255])


def test_a_picture_with_nan_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="1 of 2 values"):
        images.write(tmp_path / "a.png", np.array([[0.5, np.nan]]))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".exr", ".tif"])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 0.9])
def test_a_cut_off_file_is_one_clear_line(tmp_path: Path, suffix: str, share: float) -> None:
    path = tmp_path / f"a{suffix}"
    images.write(path, RANDOM.random((40, 50, 3)).astype(np.float32))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(DatasetError) as caught:
        images.read(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_missing_and_foreign_files(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such image"):
        images.read(tmp_path / "none.png")
    (tmp_path / "text.png").write_text("not a picture")
    with pytest.raises(DatasetError, match="cannot be read"):
        images.size(tmp_path / "text.png")
    with pytest.raises(DatasetError, match=r"\.txt"):
        images.write(tmp_path / "a.txt", np.zeros((2, 2, 3)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["text.png"]


def test_a_header_of_a_huge_image_is_refused_before_decoding(tmp_path: Path) -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 65000, 65000, 8, 2, 0, 0, 0)
    png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 10)) + chunk(b"IEND", b"")
    (tmp_path / "bomb.png").write_bytes(png)
    with pytest.raises(DatasetError, match=r"65000x65000|claims a"):  # ours, or the library's own guard against such headers
        images.read(tmp_path / "bomb.png")


def test_our_own_limit_on_the_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images.write(tmp_path / "a.png", np.zeros((10, 20, 3)))
    monkeypatch.setenv("KOALA_MAX_PIXELS", "199")
    with pytest.raises(DatasetError, match=r"too large \(its header says 20x10x3; the budget .* is 199 pixels"):
        images.read(tmp_path / "a.png")
    monkeypatch.setenv("KOALA_MAX_PIXELS", "many")
    with pytest.raises(UsageError, match="KOALA_MAX_PIXELS: is not a positive number"):
        images.read(tmp_path / "a.png")
    monkeypatch.setenv("KOALA_MAX_PIXELS", "200")
    assert images.read(tmp_path / "a.png").shape == (10, 20, 3)


def test_an_image_that_does_not_fit_into_the_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images.write(tmp_path / "a.png", np.zeros((10, 20, 3)))
    monkeypatch.setattr(images, "FREE_PIXELS", 1)
    monkeypatch.setattr(images, "free_memory", lambda: 6000)
    with pytest.raises(DatasetError, match="does not fit into the memory"):
        images.read(tmp_path / "a.png")


def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The encoder is made to lose the file's end, as it does in silence where the disk fills with the last block."""
    import shutil
    from collections import namedtuple

    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(100, 100, 0))
    monkeypatch.setattr(images, "_is_whole", lambda path: False)
    with pytest.raises(OSError) as caught:
        images.write(tmp_path / "a.png", np.zeros((4, 4, 3)))
    assert caught.value.errno == errno.ENOSPC and caught.value.filename == str(tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []


def test_srgb_curve_and_its_inverse() -> None:
    assert images.linear_from_srgb([0.5])[0] == pytest.approx(0.2140411, abs=1e-6)  # IEC 61966-2-1
    values = np.linspace(0, 1, 1001, dtype=np.float32)
    assert np.abs(images.srgb_from_linear(images.linear_from_srgb(values)) - values).max() < 1e-5  # float32


def by_hand(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """Area average by double loops over pixels and the pixels that they cover."""
    rows, columns, channels = picture.shape
    result = np.zeros((height, width, channels))
    for i in range(height):
        for j in range(width):
            for r in range(rows):
                for c in range(columns):
                    tall = min((i + 1) * rows / height, r + 1) - max(i * rows / height, r)
                    wide = min((j + 1) * columns / width, c + 1) - max(j * columns / width, c)
                    result[i, j] += max(tall, 0) * max(wide, 0) * picture[r, c]
    return result * width * height / (rows * columns)


@given(st.tuples(*[st.integers(1, 9)] * 4))
def test_resize_is_the_mean_over_what_a_pixel_covers(sizes: tuple[int, int, int, int]) -> None:
    rows, columns, height, width = sizes
    picture = RANDOM.random((rows, columns, 2)).astype(np.float32)
    assert np.abs(images.resize(picture, width, height, srgb=False) - by_hand(picture, width, height)).max() < 1e-5  # float32


def test_resize_averages_light_weighted_by_alpha() -> None:
    picture = np.array([[[1.0, 0, 0, 1.0], [0, 1.0, 0, 0.0]]], np.float32)  # red beside invisible green
    small = images.resize(picture, 1, 1)[0, 0]
    assert np.allclose(small, [1, 0, 0, 0.5], atol=1e-6)  # no green bleeds in, half covered
    grey = images.resize(np.array([[[0.0], [1.0]]], np.float32), 1, 1)[0, 0, 0]
    assert grey == pytest.approx(0.7353570, abs=1e-5)  # half the light is not half the value
