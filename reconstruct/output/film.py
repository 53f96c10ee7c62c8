"""A trained model as a film (H.264 in MP4): one or several channels side by side along a camera path."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.console import progress
from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.datasets.core.files import atomic_path, refuse_existing
from koala3d.datasets.imaging import images
from koala3d.reconstruct.output.export import EXR, brightness_of_depth, channels
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering.pictures import Picture, two_at_a_time

CHANNELS = ("rgb", "diffuse", "specular", "normals", "normals_pred", "depth_view", "opacity", "roughness")


def film(
    trained: TrainedModel, frames: Sequence[NDArray[np.float64]], out: Path, *, shown: Sequence[str] = ("rgb",), fps: float = 30.0
) -> dict[str, Any]:
    """Render `world_from_camera` poses with the first view's camera and write them to `out`.

    Raises UsageError: an unknown channel, or `out` does not end in .mp4 or exists.
    """
    for name in shown:
        if name not in CHANNELS:
            raise UsageError(f"there is no channel '{name}'", where="--channel", remedy=nearest(name, CHANNELS))
    if out.suffix.lower() != ".mp4":
        raise UsageError("films are written as MP4", where=out, remedy="end --out in .mp4")
    refuse_existing(out)
    with progress("filming", len(frames), "frames") as bar, atomic_path(out) as temporary:
        pictures = _pictures(trained, frames, shown, bar)
        size = write(pictures, temporary, fps)
    return {"out": str(out), "frames": len(frames), "size": list(size), "fps": fps, "channels": list(shown)}


def _pictures(trained: TrainedModel, frames, shown: Sequence[str], bar) -> Iterator[NDArray[np.uint8]]:
    """The channels of each frame side by side; depth over the range of the first frame, to prevent flicker."""
    view, normals = trained.scene.views[0], "normals" in shown
    camera, limits = trained.camera(view).undistorted(), None

    def frame(world_from_camera: NDArray[np.float64]) -> Picture:
        return trained.renderer.picture(
            trained.model, replace(view, world_from_camera=world_from_camera, base_from_world=None), camera, normals=normals
        )

    for picture in two_at_a_time(frame, frames):
        if limits is None:
            known = picture.depth[picture.depth > 0]
            limits = tuple(np.percentile(known, [1, 99]).tolist()) if known.size else (0.0, 1.0)
        maps = channels(picture) | {"depth_view": brightness_of_depth(picture.depth, limits)}
        parts = [np.broadcast_to(np.clip(maps[name], 0, 1), (*picture.rgb.shape[:2], 3)) for name in shown if name not in EXR]
        yield images.to_uint8(np.concatenate(parts, axis=1))
        bar.advance()


def write(pictures: Iterable[NDArray[np.uint8]], path: Path, fps: float) -> tuple[int, int]:
    """Encode (height, width, 3) pictures of one size; an odd row or column is dropped, as the format requires.

    Returns:
        (width, height) of the film.
    """
    from fractions import Fraction

    import av

    stream: Any = None
    with av.open(str(path), "w") as file:
        for picture in pictures:
            if stream is None:
                stream = file.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000))
                stream.height, stream.width = (side // 2 * 2 for side in picture.shape[:2])
                stream.pix_fmt, stream.options = "yuv420p", {"crf": "17"}
            cut = np.ascontiguousarray(picture[: stream.height, : stream.width])
            file.mux(stream.encode(av.VideoFrame.from_ndarray(cut, format="rgb24")))
        if stream is None:
            raise UsageError("a film needs at least one frame")
        file.mux(stream.encode())
    return stream.width, stream.height
