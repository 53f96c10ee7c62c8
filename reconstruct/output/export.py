"""Rendered views as image files.

DIR/rgb/NAME.png         sRGB
DIR/diffuse/NAME.png     sRGB of the diffuse part
DIR/specular/NAME.png    sRGB of the specular part
DIR/normals/NAME.png     (n + 1) / 2, world frame, from the density's gradient; grey for the background
DIR/normals_exr/NAME.exr  the same as unit vectors; zero for the background
DIR/normals_pred/NAME.png  (n + 1) / 2 of the predicted normals
DIR/depth/NAME.exr       along z [m, or the scene's unit]; 0 for the background
DIR/depth_view/NAME.png  the same for viewing: near is bright, the background black
DIR/opacity/NAME.png     0..1
DIR/roughness/NAME.png   0..1, clipped
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import files
from koala3d.datasets.core.console import progress
from koala3d.datasets.formats.links import file_name
from koala3d.datasets.imaging import images
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering.pictures import Picture, two_at_a_time

EXR = {"depth", "normals_exr"}  # channels written as EXR, unscaled


def render(trained: TrainedModel, out: Path, *, split: str = "test") -> dict[str, Any]:
    """Render the views of one split into the new folder `out`, all or none.

    Raises UsageError: the scene has no such views, or `out` is not empty.
    """
    files.refuse_existing(out)
    views = trained.scene.split(split)
    _write(zip(map(file_name, views), two_at_a_time(trained.picture, views), strict=True), len(views), out)
    return {"out": str(out), "split": split, "views": len(views)}


def render_along(trained: TrainedModel, frames: Sequence[NDArray[np.float64]], out: Path) -> dict[str, Any]:
    """Render (4, 4) `world_from_camera` poses with the first view's camera, without its distortion, into the new folder `out`.

    Files are named by frame number, from 0000.

    Raises UsageError: `out` is not empty.
    """
    files.refuse_existing(out)
    view = trained.scene.views[0]
    camera = trained.camera(view).undistorted()

    def picture(frame: NDArray[np.float64]) -> Picture:
        return trained.renderer.picture(trained.model, replace(view, world_from_camera=frame, base_from_world=None), camera)

    names = (f"{number:04d}" for number in range(len(frames)))
    _write(zip(names, two_at_a_time(picture, frames), strict=True), len(frames), out)
    return {"out": str(out), "views": len(frames)}


def _write(pictures: Iterable[tuple[str, Picture]], count: int, out: Path) -> None:
    """Write each channel of named pictures into a folder, all or none."""
    with files.atomic_folder(out) as folder, progress("rendering", count, "views") as shown:
        for name, picture in pictures:
            for channel, values in channels(picture).items():
                images.write(folder / channel / f"{name}{'.exr' if channel in EXR else '.png'}", values)
            shown.advance()


def channels(picture: Picture) -> dict[str, NDArray[np.floating]]:
    """The channels of a picture by folder: (height, width, 1 or 3), 0..1 except `EXR`."""
    return {
        "rgb": picture.rgb,
        "diffuse": images.srgb_from_linear(np.maximum(picture.diffuse, 0)),
        "specular": images.srgb_from_linear(np.maximum(picture.specular, 0)),
        "normals": (picture.normals + 1) / 2,
        "normals_exr": picture.normals,
        "normals_pred": (picture.normals_pred + 1) / 2,
        "depth": picture.depth,
        "depth_view": brightness_of_depth(picture.depth),
        "opacity": picture.opacity,
        "roughness": picture.roughness,
    }


def brightness_of_depth(depth: NDArray[np.float32], limits: tuple[float, float] | None = None) -> NDArray[np.float32]:
    """(height, width, 1) 1 at the nearest depth, 0.1 at the furthest, 0 without depth.

    Args:
        limits: nearest and furthest depth; None takes the 1st and 99th percentile of the picture.
    """
    known = depth > 0
    near, far = limits or (np.percentile(depth[known], [1, 99]) if known.any() else (0, 1))
    share = np.clip((depth - near) / max(far - near, 1e-9), 0, 1)
    return np.where(known, 1 - 0.9 * share, 0).astype(np.float32)
