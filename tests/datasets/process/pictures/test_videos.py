"""Videos as phones and cameras write them: colours by the matrix that is meant, and files that are no videos."""

from collections.abc import Sequence
from pathlib import Path

import av
import numpy as np
import pytest
from av.video.reformatter import Colorspace

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.process.pictures import videos

RED = (200, 40, 40)
UNSTATED = 2


def written(
    path: Path,
    size: tuple[int, int],
    *,
    matrix: Colorspace = Colorspace.ITU709,
    transfer: int = UNSTATED,
    primaries: int = UNSTATED,
) -> Path:
    """Three red frames of FFmpeg's that state no matrix; `transfer` and `primaries` are H.273's numbers."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"crf": "1"})
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.codec_context.color_trc, stream.codec_context.color_primaries = transfer, primaries
        for _ in range(3):
            whole = av.VideoFrame.from_ndarray(np.full((size[1], size[0], 3), RED, np.uint8), format="rgb24")
            frame = whole.reformat(format="yuv420p", dst_colorspace=matrix)
            frame.colorspace = UNSTATED
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def colour(path: Path) -> Sequence[int]:
    return videos.picture(next(videos.decoded(path)))[10, 10].tolist()


@pytest.mark.parametrize(("size", "matrix"), [((1280, 720), Colorspace.ITU709), ((640, 480), Colorspace.ITU601)])
def test_a_matrix_that_is_not_stated_is_that_of_the_size(tmp_path: Path, size: tuple[int, int], matrix: Colorspace) -> None:
    """As players take it: BT.709 from 720 lines on. The other would be off by fifteen steps."""
    assert np.abs(np.subtract(colour(written(tmp_path / "a.mp4", size, matrix=matrix)), RED)).max() <= 3


@pytest.mark.parametrize(("transfer", "primaries", "name"), [(18, 9, "HLG"), (16, 9, "PQ"), (UNSTATED, 9, "BT.2020")])
def test_colours_that_srgb_does_not_have_are_refused(tmp_path: Path, transfer: int, primaries: int, name: str) -> None:
    path = written(tmp_path / "a.mp4", (640, 480), transfer=transfer, primaries=primaries)
    with pytest.raises(DatasetError, match=rf"other colours than sRGB \(it is in {name}\); record without HDR"):
        next(videos.decoded(path))


def test_a_list_of_files_is_no_video(tmp_path: Path) -> None:
    """FFmpeg would open it by its content, and the video that it names with it."""
    written(tmp_path / "secret.mp4", (640, 480))
    (tmp_path / "list.mp4").write_text("ffconcat version 1.0\nfile secret.mp4\n")
    with pytest.raises(DatasetError, match="video cannot be read"):
        next(videos.decoded(tmp_path / "list.mp4"))


def test_frames_beyond_the_budget_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KOALA_MAX_PIXELS", "300000")
    with pytest.raises(DatasetError, match="640x480; the budget is 300000 pixels"):
        next(videos.decoded(written(tmp_path / "a.mp4", (640, 480))))


def test_another_suffix_is_no_video(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("ffconcat version 1.0\n")
    with pytest.raises(UsageError, match="is no video"):
        next(videos.decoded(tmp_path / "a.txt"))
