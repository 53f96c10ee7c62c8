"""Evaluate images that another program rendered, with the same metrics as our own.

DIR/rgb/NAME.png (or DIR/NAME.png) is required for every view. NAME.exr or NAME.png in DIR/normals_exr, DIR/normals,
DIR/normals_pred, DIR/depth, DIR/opacity, DIR/diffuse and DIR/specular are optional: the layout of 'reconstruct render'.

8-bit images hold sRGB, normals as (n + 1) / 2; EXR files hold linear light, unit normals, depth along z [m, or the scene's
unit].
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import files
from koala3d.datasets.core.console import progress
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats.links import file_name
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct.output.evaluate import compare, read_truth, summary
from koala3d.reconstruct.output.lpips import Lpips

SINGLE = ("normals_pred", "depth", "opacity", "diffuse", "specular")
FOLDERS = {"rgb": ("rgb", "."), "normals": ("normals_exr", "normals"), **{name: (name,) for name in SINGLE}}
"""Folders of each map; the first match is used."""
SUFFIXES = (".exr", ".png", ".jpg", ".jpeg", ".tif", ".tiff")
MAPS = {"depth": 1, "opacity": 1}  # channels of a map; the others have three


def measure(
    folder: Path, scene: Scene, *, split: str = "test", out: Path | None = None, lpips: Lpips | None = None
) -> dict[str, Any]:
    """Metrics of the images in `folder` for the scene's views of one split, written to `out` (JSON) if given.

    Args:
        lpips: also compute the perceptual distance.

    Raises:
        UsageError: no such folder or views, an image is missing, or `out` exists.
        DatasetError: an image has another aspect ratio than its view.
    """
    if not folder.is_dir():
        raise UsageError("is not a folder", where=folder, remedy="give the folder with the rendered images")
    if out is not None:
        files.refuse_existing(out)
    views, measured, sizes = scene.split(split), [], set()
    with progress("measuring", len(views), "views") as shown:
        for view in views:
            maps = read_rendering(folder, view)
            height, width = maps["rgb"].shape[:2]
            sizes.add((width, height))
            truth = read_truth(view, view.camera.scaled(width, height))
            measured.append({"name": view.name, **compare(maps, truth, metric=scene.metric, lpips=lpips)})
            shown.advance()
    result = summary(split, measured, list(max(sizes)), lpips) | {"renders": str(folder)}
    if out is not None:
        files.write_json(out, result)
    return result


def read_rendering(folder: Path, view: View) -> dict[str, NDArray[np.float32]]:
    """The maps of one view as `evaluate.compare` takes them: rgb in sRGB over white, diffuse and specular linear."""
    found = {}
    for name, places in FOLDERS.items():
        path = next((p for place in places if (p := _file(folder / place, view))), None)
        if path is not None:
            found[name] = _decoded(name, path)
    if "rgb" not in found:
        advice = f"name it rgb/{file_name(view)}.png, at the scene's size or a fraction of it"
        raise UsageError(f"has no rendering of view {view.name}", where=folder, remedy=advice)
    height, width = found["rgb"].shape[:2]
    if abs(width * view.camera.height - height * view.camera.width) > max(view.camera.width, view.camera.height):
        why = f"{width}x{height}, the view has {view.camera.width}x{view.camera.height}"
        raise DatasetError(f"rendering of view {view.name} has another aspect ratio than the view", where=folder, why=why)
    for name, values in found.items():
        if values.shape[:2] != (height, width):
            why = f"{values.shape[1]}x{values.shape[0]}, colour has {width}x{height}"
            raise DatasetError(f"{name} of view {view.name} has another size than its colour", where=folder, why=why)
    return found


def _file(folder: Path, view: View) -> Path | None:
    return next((path for suffix in SUFFIXES if (path := folder / f"{file_name(view)}{suffix}").is_file()), None)


def _decoded(name: str, path: Path) -> NDArray[np.float32]:
    values, linear = images.read(path), path.suffix == ".exr"
    if name in MAPS:
        return values[..., :1]
    if name == "rgb":
        alpha = values[..., 3:] if values.shape[-1] == 4 else np.ones_like(values[..., :1])
        colour = np.broadcast_to(values[..., :3], (*values.shape[:2], 3))
        return (images.srgb_from_linear(np.maximum(colour, 0)) if linear else colour) * alpha + 1 - alpha
    if name in ("diffuse", "specular"):
        return values[..., :3] if linear else images.linear_from_srgb(values[..., :3])
    vectors = values[..., :3] if linear else 2 * values[..., :3] - 1
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 0.5, vectors / np.maximum(length, 1e-6), 0).astype(np.float32)  # grey: background
