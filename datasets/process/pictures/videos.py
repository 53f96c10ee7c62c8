"""Opening videos and decoding their frames as upright sRGB pictures.

A file is opened as what its suffix says, never as what it contains: lists of other files would be followed. FFmpeg may read
files alone, nothing over a network.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.budgets import budget
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging.images import FREE_PIXELS, PIXELS

FORMATS = {
    ".mp4": "mov", ".mov": "mov", ".m4v": "mov", ".3gp": "mov", ".avi": "avi", ".mkv": "matroska", ".webm": "matroska",
    ".mts": "mpegts", ".mpg": "mpeg", ".mpeg": "mpeg",
}  # fmt: skip
"""FFmpeg's demuxer of each suffix."""
HDR = {16: "PQ", 18: "HLG"}
"""Transfer functions of high dynamic range, by their number in ITU-T H.273."""
WIDE = {9: "BT.2020", 11: "DCI-P3", 12: "Display P3"}
"""Primaries that sRGB does not have."""
UNSTATED, HD = 2, 720
"""Number of a matrix that is not stated, and the height from which it is BT.709's, as players take it."""


def is_video(path: Path) -> bool:
    """True for a file with the suffix of a video."""
    return path.is_file() and path.suffix.lower() in FORMATS


def picture(frame: Any) -> NDArray[np.uint8]:
    """(height, width, 3) sRGB of a frame, turned as the video says."""
    from av.video.reformatter import Colorspace

    matrix: dict[str, Any] = {}
    if frame.colorspace == UNSTATED:
        matrix = {"src_colorspace": Colorspace.ITU709 if min(frame.width, frame.height) >= HD else Colorspace.ITU601}
    colours = frame.reformat(format="rgb24", **matrix).to_ndarray()
    return np.ascontiguousarray(np.rot90(colours, round(frame.rotation / 90) % 4))


def length(video: Path) -> int:
    """Number of frames by the header; 0 if it does not say."""
    import av

    with _opened(video) as container:
        stream = container.streams.video[0]
        if stream.frames:
            return int(stream.frames)
        rate = stream.average_rate or 30
        return int(container.duration / av.time_base * rate) if container.duration else 0


def decoded(video: Path) -> Iterator[Any]:
    """Frames one by one; a file that is cut off ends early.

    Raises:
        UsageError: it is no video.
        DatasetError: it cannot be read, its frames are too large, or its colours are not those of sRGB.
    """
    from av.error import FFmpegError

    with _opened(video) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        _check_size(stream.width, stream.height, video)  # before anything is decoded
        try:
            for frame in container.decode(stream):
                _check_size(frame.width, frame.height, video)
                _check_colours(frame, video)
                yield frame
        except FFmpegError:
            return


def _check_size(width: int, height: int, video: Path) -> None:
    allowed = budget(PIXELS, FREE_PIXELS)
    if width * height > allowed:
        why, remedy = f"{width}x{height}; the budget is {allowed} pixels", f"set {PIXELS} to a larger number"
        raise DatasetError("frames of the video are too large", where=video, why=why, remedy=remedy)


def _check_colours(frame: Any, video: Path) -> None:
    kind = HDR.get(frame.color_trc) or WIDE.get(frame.color_primaries)
    if kind is not None:
        remedy = "record without HDR, or export it in standard colours (Rec. 709): docs/photographs.md says how"
        raise DatasetError("video has other colours than sRGB", where=video, why=f"it is in {kind}", remedy=remedy)


def _opened(video: Path) -> Any:
    import av
    from av.error import FFmpegError

    found = FORMATS.get(Path(video).suffix.lower())
    if found is None:
        raise UsageError("is no video", where=video, why=f"suffixes read are {', '.join(FORMATS)}")
    if not Path(video).is_file():  # opening a pipe would wait for its writer
        raise UsageError("no such video", where=video, remedy="check the path")
    try:
        container = av.open(str(video), format=found, options={"protocol_whitelist": "file"})
    except (FFmpegError, UnicodeDecodeError) as error:  # the latter: its names are damaged
        why = str(getattr(error, "strerror", None) or error)
        raise DatasetError("video cannot be read", where=video, why=why, remedy="copy it again") from None
    if not container.streams.video:
        container.close()
        raise UsageError("holds no moving pictures", where=video, remedy="give a video or a folder of photographs")
    if getattr(container.streams.video[0], "codec_context", None) is None:
        container.close()
        why, remedy = "it is of no known kind", "convert it to H.264 in an .mp4"
        raise DatasetError("pictures of the video cannot be decoded", where=video, why=why, remedy=remedy)
    return container
