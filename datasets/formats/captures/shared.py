"""Shared by readers of capture programs: images by their labels, and worlds whose origin is far away."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.formats.assemble import Gathering
from koala3d.datasets.formats.finding.pictures import Listing, homes
from koala3d.datasets.formats.finding.stated import plain
from koala3d.datasets.scene import View

DISTANT = 1e5
"""Worlds whose origin is further away are moved to the middle of the cameras: geocentric ones, in which floats end [m]."""


def places(folder: Path, wanted: str | None) -> list[Path]:
    """Folders that may hold the images: `wanted`, else all folders of images and the folder itself."""
    return [files.inside(folder, wanted)] if wanted is not None else [*homes(folder), folder]


def image(listing: Listing, among: list[Path], label: str) -> Path | None:
    """The image of a label, which is a file's name with or without suffix, or a whole path of another machine."""
    name = plain(label).name
    return next((found for place in among if name and (found := listing.like(place, name)) is not None), None)


def with_masks(gathering: Gathering) -> None:
    """Give each view the mask that lies beside its image or in a folder of masks, if all images are in one folder."""
    if len({view.image.parent for view in gathering.views}) == 1:
        masks = gathering.masks(gathering.views[0].image.parent, [view.image.name for view in gathering.views])
        gathering.views = [replace(view, mask=mask) for view, mask in zip(gathering.views, masks, strict=True)]


def near_the_origin(views: tuple[View, ...]) -> tuple[tuple[View, ...], list[str]]:
    """The views, moved to the middle of the cameras if the world's origin is far away, and a note on that."""
    middle = np.mean([view.world_from_camera[:3, 3] for view in views], axis=0).round()
    if np.linalg.norm(middle) < DISTANT:
        return views, []
    moved = pose.rigid(np.eye(3), -middle)
    said = f"the world is moved by {', '.join(f'{-value:.0f}' for value in middle)}: its origin is far from the cameras"
    return tuple(replace(view, world_from_camera=moved @ view.world_from_camera) for view in views), [said]
