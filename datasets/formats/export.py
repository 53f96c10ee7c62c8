"""What the writers of foreign layouts share: each view as a centred pinhole, its image and truth in place.

A view that is a centred pinhole already keeps its files to the bit; any other is resampled once.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets import images, undistort
from datasets.errors import DatasetError
from datasets.formats.koala import file_name, link
from datasets.scene import Scene, View

ORDERS = {"normals": undistort.NEAREST, "depth": undistort.NEAREST}
"""Interpolation of truth maps that must not be mixed across edges; the others are linear."""


@dataclass(frozen=True)
class Placed:
    """A view as exported, and by how much its axis was turned."""

    view: View
    turned_deg: float
    resampled: bool


def place(view: View, folder: Path, stem: str, *, merge_mask: bool) -> Placed:
    """Write one view's image to `stem` below `folder`, and its mask and truth.

    Args:
        view: the view.
        folder: of the export.
        stem: relative path of the image without its suffix.
        merge_mask: put a mask into the image's alpha; else it goes to masks/.
    """
    try:
        pinhole = undistort.pinhole(view.camera)
    except ValueError as error:
        raise DatasetError("view cannot be made a pinhole", where=f"view {view.name}", why=str(error)) from None
    same = view.camera.is_centred
    target = folder / stem
    merged = merge_mask and view.mask is not None
    if same and not merged:
        image = _kept(view, view.image, target)
    else:
        as_float = view.image.suffix.lower() == ".exr"
        picture = view.read_image()
        if merged and view.mask is not None:
            picture = np.concatenate([picture[..., :3], view.read()[..., 3:]], axis=-1)
        if not same:
            picture = pinhole.resample(picture, undistort.SMOOTH if as_float else undistort.COLOUR)
        image = _written(target, ".exr" if as_float else ".png", picture)
    mask = None
    if view.mask is not None and not merged:
        at = folder / "masks" / Path(stem).name
        mask = (
            _kept(view, view.mask, at)
            if same
            else _written(at, ".png", pinhole.resample(images.read(view.mask), undistort.SMOOTH))
        )
    truth = {key: _truth(view, key, folder / "truth" / key / file_name(view), pinhole, same) for key in view.truth}
    matrix = view.world_from_camera if same else view.world_from_camera @ pinhole.source_from_camera
    placed = replace(view, camera=pinhole.camera, world_from_camera=matrix, image=image, mask=mask, truth=truth)
    return Placed(placed, pinhole.turned_deg, not same)


def limits(scene: Scene, placed: list[Placed], layout: str) -> str:
    """One line on what the layout cannot hold of this scene, and what was done about it; empty where it holds all."""
    lost = []
    resampled = [p for p in placed if p.resampled]
    if resampled:
        sizes = sorted({(p.view.camera.width, p.view.camera.height) for p in resampled})
        shown = ", ".join(f"{width}x{height}" for width, height in sizes[:3])
        turned = max(p.turned_deg for p in resampled)
        lost.append(f"lens distortion or an off-centre principal point: {len(resampled)} views were resampled to centred "
                    f"pinholes of {shown}, their axes turned by up to {turned:.2f} degrees")  # fmt: skip
    if scene.metric or any(view.truth for view in scene.views) or scene.background == "scene":
        lost.append("bounds, background, scale and truth: koala.json beside it keeps them")
    return f"{layout} cannot hold " + "; nor ".join(lost) if lost else ""


def _kept(view: View, source: Path, target: Path) -> Path:
    if not source.is_file():
        raise DatasetError("file is missing", where=source, why=f"view {view.name} needs it")
    path = target.with_name(target.name + source.suffix)
    link(source, path)
    return path


def _written(target: Path, suffix: str, picture: np.ndarray) -> Path:
    path = target.with_name(target.name + suffix)
    if path.exists():
        raise DatasetError("two views would share a file", where=path, remedy="give each view its own name")
    images.write(path, picture)
    return path


def _truth(view: View, key: str, target: Path, pinhole: undistort.Pinhole, same: bool) -> Path:
    if same:
        return _kept(view, view.truth[key], target)
    values = pinhole.resample(view.read_truth(key), ORDERS.get(key, undistort.SMOOTH))
    if key == "depth":
        values = values * pinhole.depth_factor()
    return _written(target, ".png" if key == "alpha" else ".exr", values)
