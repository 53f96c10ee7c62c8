"""Frames of a video: evenly spaced by movement, sharp, and clear words for files that are none."""

from collections.abc import Callable, Sequence
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from koala3d.datasets.core.errors import DatasetError, KoalaError, UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.process.pictures import frames

WIDTH, HEIGHT = 320, 240
IDENTITY = [1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30]
"""Matrix of a video that is not turned, as MP4 stores it."""


@pytest.fixture(scope="module")
def wall() -> NDArray[np.uint8]:
    """A wide picture with texture of several sizes."""
    random = np.random.default_rng(0)
    noise = sum(s * gaussian_filter(random.normal(size=(HEIGHT, 2000)), s) for s in (1.5, 4, 10))
    return np.clip(128 + 60 * noise / np.std(noise), 0, 255).astype(np.uint8)


def written(path: Path, pictures: Sequence[NDArray[np.uint8]]) -> Path:
    """A video of grey pictures."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = WIDTH, HEIGHT, "yuv420p", 4_000_000
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.repeat(picture[..., None], 3, -1), "rgb24")))
        container.mux(stream.encode())
    return path


@pytest.fixture
def pan(wall: NDArray[np.uint8], tmp_path: Path) -> Callable[..., Path]:
    """Factory of videos that show the wall at these columns; every frame whose number is in `blurred` is out of focus."""

    def make(columns: Sequence[int], blurred: Sequence[int] = ()) -> Path:
        pictures = [np.ascontiguousarray(wall[:, column : column + WIDTH]) for column in columns]
        pictures = [cv2.GaussianBlur(p, (0, 0), 2.5) if i in blurred else p for i, p in enumerate(pictures)]
        return written(tmp_path / "pan.mp4", pictures)

    return make


def test_movement_is_measured_in_picture_diagonals(pan: Callable[..., Path]) -> None:
    motion = frames.observe(pan([4 * k for k in range(20)]))
    assert len(motion.sharpness) == len(motion.moved) == 20
    np.testing.assert_allclose(np.diff(motion.moved), 4 / np.hypot(WIDTH, HEIGHT), rtol=0.1)


def test_frames_are_spaced_by_movement_and_not_by_time(pan: Callable[..., Path]) -> None:
    """The camera moves, rests for 30 frames, and moves on twice as fast."""
    columns = [*range(0, 80, 4), *[80] * 30, *range(80, 240, 8)]
    chosen = frames.choose(frames.observe(pan(columns)), 12)
    steps = np.diff(np.array(columns)[chosen])
    assert len(chosen) == 12 and steps.min() >= 10 and steps.max() <= 30  # windows of 20 columns, middle half of each
    assert sum(20 <= index < 50 for index in chosen) <= 2


def test_blurred_frames_are_passed_over(pan: Callable[..., Path]) -> None:
    blurred = [k for k in range(60) if k % 3]
    chosen = frames.choose(frames.observe(pan([3 * k for k in range(60)], blurred)), 8)
    assert len(chosen) == 8 and not set(chosen) & set(blurred)


def test_a_short_movement_gives_fewer_frames(pan: Callable[..., Path]) -> None:
    assert len(frames.choose(frames.observe(pan(range(0, 20))), 50)) == 4  # 19 columns are 4.75% of the diagonal of 400


def test_the_chosen_frames_are_written_by_number(pan: Callable[..., Path], wall: NDArray[np.uint8], tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    names = frames.extract(pan([4 * k for k in range(40)]), 6, tmp_path / "frames", done=lambda k, n: seen.append((k, n)))
    assert len(names) == 6 and sorted(p.name for p in (tmp_path / "frames").iterdir()) == names
    index = int(names[2].removeprefix("frame_").removesuffix(".jpg"))
    picture = 255 * images.read(tmp_path / "frames" / names[2])[..., 0]
    assert np.abs(picture - wall[:, 4 * index : 4 * index + WIDTH]).mean() < 8  # two lossy encodings
    assert all(k <= n for k, n in seen) and [k for k, _ in seen] == sorted(k for k, _ in seen)


def test_a_turned_video_gives_upright_frames(pan: Callable[..., Path], wall: NDArray[np.uint8], tmp_path: Path) -> None:
    """The matrix in the file's track header is that of a phone held upright: to be turned clockwise for display."""
    path = pan([4 * k for k in range(20)])
    whole, clockwise = (np.array(m, ">i4").tobytes() for m in (IDENTITY, [0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30]))
    data = path.read_bytes()
    track = data.index(b"tkhd")
    place = data.index(whole, track)
    path.write_bytes(data[:place] + clockwise + data[place + len(whole) :])
    name = frames.extract(path, 3, tmp_path / "frames")[0]
    picture = 255 * images.read(tmp_path / "frames" / name)[..., 0]
    index = int(name.removeprefix("frame_").removesuffix(".jpg"))
    assert np.abs(picture - np.rot90(wall[:, 4 * index : 4 * index + WIDTH], -1)).mean() < 8  # two lossy encodings


def test_of_a_camera_that_jumps_the_sharp_frames_are_taken(pan: Callable[..., Path]) -> None:
    """Three frames at each place, of which the second is sharp; jumps are larger than windows."""
    columns = [40 * (k // 3) for k in range(30)]
    chosen = frames.choose(frames.observe(pan(columns, [k for k in range(30) if k % 3 != 1])), 20)
    assert {index % 3 for index in chosen} == {1} and len(chosen) == 10


def test_a_video_that_is_cut_off_gives_the_frames_before(pan: Callable[..., Path], tmp_path: Path) -> None:
    pictures = [np.full((HEIGHT, WIDTH), 8 * k, np.uint8) for k in range(20)]
    path = written(tmp_path / "whole.mpg", pictures)
    cut = tmp_path / "cut.mpg"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert 0 < len(frames.observe(cut).moved) < 20


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [(b"no video at all", DatasetError, "video cannot be read"), (b"", DatasetError, "video cannot be read")],
)
def test_a_file_that_is_no_video_is_refused(tmp_path: Path, content: bytes, error: type[KoalaError], words: str) -> None:
    path = tmp_path / "film.mp4"
    path.write_bytes(content)
    with pytest.raises(error, match=words):
        frames.extract(path, 10, tmp_path / "frames")
    assert not (tmp_path / "frames").exists()


def test_a_video_of_nothing_moving_is_refused(pan: Callable[..., Path], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="too little movement"):
        frames.extract(pan([50] * 20), 10, tmp_path / "frames")
