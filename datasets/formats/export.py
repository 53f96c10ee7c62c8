"""Shared by the writers of foreign formats: views as the format can hold them, with image, mask and truth in place.

A view that the format can hold keeps its files bit for bit; any other is resampled once, to a centred pinhole.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.core.progress import Step
from koala3d.datasets.formats.links import copy, file_name, new_file
from koala3d.datasets.imaging import images, undistort
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.imaging.reduced import READERS
from koala3d.datasets.scene import DISPARITY, LOSSY, Scene, View

ORDERS = {"normals": undistort.NEAREST, "depth": undistort.NEAREST}
"""Interpolation of truth maps that must not be mixed across edges; the others are interpolated linearly."""


@dataclass(frozen=True)
class PlacedView:
    """A view as exported, and the rotation of its axis."""

    view: View
    turned_deg: float
    resampled: bool


@dataclass(frozen=True)
class Layout:
    """What a format can hold of a view."""

    title: str
    holds: Callable[[Camera], bool]
    """True for cameras that it can describe."""
    lacks: str
    """What it cannot describe of other cameras."""
    mask: str | None = None
    """Path of a view's mask without suffix, from {stem} and {file} of the image; None to put it into the image's alpha."""


def place(view: View, folder: Path, stem: str, layout: Layout) -> PlacedView:
    """Write one view's image to `stem` (relative, without its suffix) below `folder`, and its mask and truth.

    Raises:
        DatasetError: a file is missing or damaged, two views would share one, or the lens leaves no picture.
    """
    try:
        pinhole = undistort.pinhole(view.camera)
    except ValueError as error:
        raise DatasetError("view cannot be made a pinhole", where=f"view {view.name}", why=str(error)) from None
    same = layout.holds(view.camera)
    merged = layout.mask is None and view.mask is not None
    if same and not merged:
        image = _kept(view.image, folder, stem)
    else:
        image = _redrawn(view, folder, stem, None if same else pinhole, merged=merged)
    hidden = view.mask or view.ignored
    if hidden is not None:
        hidden = None if layout.mask is None else _hidden(hidden, folder, layout.mask, image, None if same else pinhole)
    mask, ignored = (hidden, None) if view.mask else (None, hidden)
    truth = {key: _truth(view, key, folder, pinhole, same) for key in view.truth}
    if same:
        return PlacedView(replace(view, image=image, mask=mask, ignored=ignored, truth=truth, deviation=None), 0.0, False)
    matrix = view.world_from_camera @ pinhole.source_from_camera
    view = replace(view, camera=pinhole.camera, world_from_camera=matrix, mask=mask, ignored=ignored)
    return PlacedView(replace(view, image=image, truth=truth, deviation=None), pinhole.turned_deg, True)


def _hidden(source: Path, folder: Path, place: str, image: Path, pinhole: undistort.Pinhole | None) -> Path:
    """A mask at the place that the layout has for it, straightened if there is a pinhole."""
    at = place.format(stem=image.stem, file=image.name)
    return _kept(source, folder, at) if pinhole is None else _written(folder, f"{at}.png", _straightened(source, pinhole))


def place_all(
    views: Sequence[View], folder: Path, stem_of: Callable[[View], str], layout: Layout, done: Step
) -> list[PlacedView]:
    """`place` every view at the stem that `stem_of` gives; `done` is called after each. Raises as `place` does."""
    placed = []
    for one in streamed(lambda view: place(view, folder, stem_of(view), layout), views, workers=READERS):
        placed.append(one)
        done()
    return placed


def moved(old: View, new: View, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) pixels of a view to (n, 2) pixels of the view that was placed for it."""
    if old.camera == new.camera:
        return pixels
    rays = old.camera.directions(pixels) @ (new.world_from_camera[:3, :3].T @ old.world_from_camera[:3, :3]).T
    return new.camera.project(rays)


def limits(scene: Scene, placed: Sequence[PlacedView], layout: Layout) -> str:
    """One line on what the format cannot hold of this scene and what was done about it; empty where it holds everything."""
    lost = []
    resampled = [p for p in placed if p.resampled]
    if resampled:
        sizes = sorted({(p.view.camera.width, p.view.camera.height) for p in resampled})
        shown = ", ".join(f"{width}x{height}" for width, height in sizes[:3])
        turned = max(p.turned_deg for p in resampled)
        lost.append(
            f"{layout.lacks}: {len(resampled)} views were resampled to centred "
            f"pinholes of {shown}, their axes turned by up to {turned:.2f} degrees"
        )
    merged = sum(view.mask is not None for view in scene.views) if layout.mask is None else 0
    if merged:
        lost.append(f"masks beside images: {merged} were put into the images' alpha")
    if layout.mask is None and any(view.ignored for view in scene.views):
        lost.append("pixels that are to be ignored")
    if scene.metric or any(view.truth for view in scene.views) or scene.background == "scene":
        lost.append("bounds, background, scale and truth: koala.json keeps them")
    return f"{layout.title} cannot hold " + "; nor ".join(lost) if lost else ""


def _kept(source: Path, folder: Path, stem: str) -> Path:
    return copy(source, folder, stem + source.suffix)


def _redrawn(view: View, folder: Path, stem: str, pinhole: undistort.Pinhole | None, *, merged: bool) -> Path:
    """The image with its mask as alpha, or resampled, or both, at the bit depth of its file."""
    suffix = view.image.suffix.lower()
    picture = view.read_stored()
    if merged:
        mask = view.read_mask()
        same = {np.dtype(np.uint8): images.to_uint8, np.dtype(np.uint16): images.to_uint16}.get(picture.dtype, np.asarray)
        picture = np.concatenate([picture[..., :3], same(mask)], axis=-1)
    if pinhole is not None:
        how = undistort.QUICK if suffix in LOSSY else undistort.COLOUR
        picture = pinhole.resample(picture, undistort.SMOOTH if suffix == ".exr" else how)
    if suffix != ".exr" and (merged or suffix not in LOSSY):
        suffix = ".png"
    return _written(folder, f"{stem}{suffix}", picture, view.image)


def _straightened(mask: Path, pinhole: undistort.Pinhole) -> NDArray[Any]:
    return pinhole.resample(images.read_stored(mask), undistort.SMOOTH)


def _written(folder: Path, name: str, picture: NDArray[np.generic], source: Path | None = None) -> Path:
    """Write a picture with the metadata of its source file."""
    path = new_file(folder, name)
    images.write(path, picture, metadata=images.metadata(source) if source else None)
    return path


def _truth(view: View, key: str, folder: Path, pinhole: undistort.Pinhole, same: bool) -> Path:
    stem = f"truth/{key}/{file_name(view)}"
    if same:
        source = view.truth[key]
        disparity = key == "depth" and source.stem.endswith(DISPARITY)  # its name states its encoding
        return _kept(source, folder, stem + DISPARITY if disparity else stem)
    values = pinhole.resample(view.read_truth(key), ORDERS.get(key, undistort.SMOOTH))
    if key == "depth":
        values = values * pinhole.depth_factor()
    return _written(folder, f"{stem}{'.png' if key == 'alpha' else '.exr'}", values)
