"""What the masks of a scene's views say: which colour is the object, and the space that holds it.

Many masks are read for that. The answer is kept in Koala's cache for as long as files, cameras and poses stay the same.
"""

import hashlib
import json
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.datasets.splits import evenly
from koala3d.datasets.structure import bounds
from koala3d.datasets.structure.masks import polarity
from koala3d.datasets.structure.masks.hull import visual_hull
from koala3d.datasets.structure.masks.silhouette import silhouettes

VERSION = 3
"""Raised when the same masks give another answer: older ones are then not used."""
LOOKED_AT = 5
"""Views of which one must have a mask or an alpha, evenly spread."""


@dataclass(frozen=True, eq=False)
class Outlined:
    """What the masks or alphas of some views say."""

    inverted: str = ""
    """Why black is the object in the files of the masks; empty where white is."""
    ignored: bool = False
    """Whether black is not the background of an object but what is to be ignored: white surrounds the whole scene."""
    box: bounds.Box | None = None
    """(2, 3) corners of the object's box; None where no pixel is marked as empty."""
    near: float = 0.0
    """Least depth of the object over all cameras."""
    far: float = 0.0
    """Greatest depth."""
    views_used: int = 0
    """Number of views whose masks were read; 0 where they exclude everything, and the box is all that the cameras see."""


def outlined(views: Sequence[View]) -> Outlined:
    """What masks or alphas say; computed once for the same files. Raises DatasetError where one of them is damaged."""
    if not any(view.mask or images.channels(view.image) in (2, 4) for view in evenly(views, LOOKED_AT)):
        return Outlined()
    path = _place(views)
    if path is not None and (kept := _kept(path)):
        return kept
    found = _computed(views)
    if path is not None:
        with suppress(OSError):  # the cache saves time, no more
            files.make_folder(path.parent)
            files.write_json(path, asdict(found))
    return found


def _computed(views: Sequence[View]) -> Outlined:
    train = [view for view in views if view.split == "train"] or views
    box, found = bounds.visible_box(train), silhouettes(train)
    masked = all(view.mask for view in views)
    why = polarity.inverted(found, box) if masked else ""
    if masked and not why and not all(one.inside.all() for one in found) and polarity.of_surroundings(found):
        return Outlined(ignored=True)
    if why:
        found = silhouettes([replace(view, mask_inverted=True) for view in train])
    if all(one.inside.all() for one in found):  # an opaque alpha does not count
        return Outlined(why)
    hull = visual_hull(found, box)
    return Outlined(why, False, hull.box, *hull.depth_range(views), hull.views_used)


def _place(views: Sequence[View]) -> Path | None:
    """File of the answer, named by what it depends on; None where a file is missing."""
    rows = []
    for view in views:
        path = view.mask or view.image
        try:
            state = os.stat(path)
        except OSError:
            return None
        camera = {**asdict(view.camera), "kind": type(view.camera).__name__}
        rows.append([str(path.absolute()), state.st_size, state.st_mtime_ns, view.mask is None, view.mask_inverted])
        rows[-1] += [view.split, view.world_from_camera.tolist(), camera]
    key = hashlib.sha256(json.dumps([VERSION, rows], default=files.plain).encode()).hexdigest()[:24]
    return files.cache_folder() / "outlines" / f"{key}.json"


def _kept(path: Path) -> Outlined | None:
    """The answer in a file of the cache; None where there is none, or it is damaged."""
    try:
        content: dict[str, Any] = files.read_json(path)
        box = content["box"] if content["box"] is None else np.array(content["box"], np.float64).reshape(2, 3)
        numbers = float(content["near"]), float(content["far"]), int(content["views_used"])
        return Outlined(str(content["inverted"]), bool(content["ignored"]), box, *numbers)
    except (KoalaError, OSError, KeyError, TypeError, ValueError):
        return None
