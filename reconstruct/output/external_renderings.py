"""Measure pictures that another program rendered, with the same ruler as our own.

DIR/rgb/NAME.png (or DIR/NAME.png) is needed of every view; NAME.exr or NAME.png in DIR/normals_exr, DIR/normals, DIR/normals_pred,
DIR/depth, DIR/opacity, DIR/diffuse and DIR/specular is compared where it is there: the layout of 'reconstruct render'.

8-bit pictures hold sRGB, normals as (n + 1) / 2; EXR files hold linear light, unit normals, depth along z [m, or the
scene's unit].
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.core import files
from datasets.core.console import progress
from datasets.core.errors import DatasetError, UsageError
from datasets.formats.koala import file_name
from datasets.imaging import images
from datasets.scene import Scene, View
from reconstruct.output.evaluate import FORMAT, VERSION, compare, definitions, mean, read_truth, source_of
from reconstruct.output.lpips import Lpips

FOLDERS = {"rgb": ("rgb", "."), "normals": ("normals_exr", "normals"), "normals_pred": ("normals_pred",), "depth": ("depth",),
           "opacity": ("opacity",), "diffuse": ("diffuse",), "specular": ("specular",)}  # fmt: skip
"""Where each map may lie, first found first taken."""
SUFFIXES = (".exr", ".png", ".jpg", ".jpeg", ".tif", ".tiff")
MAPS = {"depth": 1, "opacity": 1}
"""Channels of a map; the others have three."""


def measure(
    folder: Path, scene: Scene, *, split: str = "test", out: Path | None = None, lpips: Lpips | None = None
) -> dict[str, Any]:
    """Figures of the renderings in `folder` of the scene's views of one split; written to `out` (JSON) where that is given.

    Args:
        lpips: measure the perceptual distance too.

    Raises:
        UsageError: no such folder, no such views, a view's rendering is missing, or `out` exists.
        DatasetError: a rendering has another shape than its view.
    """
    if not folder.is_dir():
        raise UsageError("is not a folder", where=folder, remedy="give the folder with the renderings")
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
    result = {"format": FORMAT, "version": VERSION, "split": split, "views": len(measured), "size": list(max(sizes)),
              "renders": str(folder), "mean": mean(measured), "per_view": measured, "definitions": definitions(), **source_of(lpips)}  # fmt: skip
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
        raise UsageError(f"has no rendering of view {view.name}", where=folder,
                     remedy=f"name it rgb/{file_name(view)}.png, at the scene's size or a share of it")  # fmt: skip
    height, width = found["rgb"].shape[:2]
    if abs(width * view.camera.height - height * view.camera.width) > max(view.camera.width, view.camera.height):
        raise DatasetError(f"rendering of view {view.name} has another shape than the view", where=folder,
                           why=f"{width}x{height}, the view has {view.camera.width}x{view.camera.height}")  # fmt: skip
    for name, values in found.items():
        if values.shape[:2] != (height, width):
            raise DatasetError(f"{name} of view {view.name} has another size than its colour", where=folder,
                               why=f"{values.shape[1]}x{values.shape[0]} beside {width}x{height}")  # fmt: skip
    return found


def _file(folder: Path, view: View) -> Path | None:
    return next((path for suffix in SUFFIXES if (path := folder / f"{file_name(view)}{suffix}").is_file()), None)


def _decoded(name: str, path: Path) -> NDArray[np.float32]:
    values, numbers = images.read(path), path.suffix == ".exr"
    if name in MAPS:
        return values[..., :1]
    if name == "rgb":
        alpha = values[..., 3:] if values.shape[-1] == 4 else np.ones_like(values[..., :1])
        colour = np.broadcast_to(values[..., :3], (*values.shape[:2], 3))
        return (images.srgb_from_linear(np.maximum(colour, 0)) if numbers else colour) * alpha + 1 - alpha
    if name in ("diffuse", "specular"):
        return values[..., :3] if numbers else images.linear_from_srgb(values[..., :3])
    vectors = values[..., :3] if numbers else 2 * values[..., :3] - 1
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 0.5, vectors / np.maximum(length, 1e-6), 0).astype(np.float32)  # grey: nothing is seen
