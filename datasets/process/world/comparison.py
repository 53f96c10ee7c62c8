"""The poses of one scene against those of another of the same pictures, after the similarity that fits the camera positions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.process.world.similarity import between
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure import bounds

FEWEST = 3
"""Views that determine a similarity."""


@dataclass(frozen=True, eq=False)
class Difference:
    """How far the poses of n paired views are from those of the reference."""

    names: tuple[str, ...]
    """Names in the reference."""
    positions: NDArray[np.float64]
    """(n,) distance between the cameras, as a share of the median distance to where they look."""
    turns_deg: NDArray[np.float64]
    """(n,) angle between the orientations."""
    fitted_deg: NDArray[np.float64]
    """(n,) the same after the rotation that fits the orientations instead of the positions."""


def compared(scene: Scene, reference: Scene) -> Difference:
    """Poses of a scene against a reference's. Raises UsageError where fewer than three pictures are the same."""
    both = paired(scene.views, reference.views)
    if len(both) < FEWEST:
        why = f"{len(both)} of {len(scene.views)} views have the same picture or name in both"
        remedy = "compare scenes of the same photographs"
        raise UsageError("scenes cannot be compared", where=scene.name, why=why, remedy=remedy)
    given, wanted = (np.stack([pair[k].world_from_camera for pair in both]) for k in (0, 1))
    fit = between(given[:, :3, 3], wanted[:, :3, 3])
    distance = float(np.median(np.linalg.norm(wanted[:, :3, 3] - bounds.middle(wanted, reference.box), axis=1)))
    shift = np.linalg.norm(fit.points(given[:, :3, 3]) - wanted[:, :3, 3], axis=1) / distance
    turned = fit.rotation @ given[:, :3, :3]
    u, _, vt = np.linalg.svd((wanted[:, :3, :3] @ turned.swapaxes(1, 2)).sum(0))
    rest = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    names = tuple(view.name for _, view in both)
    return Difference(names, shift, _degrees(turned, wanted[:, :3, :3]), _degrees(rest @ turned, wanted[:, :3, :3]))


def paired(views: Sequence[View], reference: Sequence[View]) -> list[tuple[View, View]]:
    """Views of the same picture: with the same bytes, whatever their names, else with the same name."""
    by_bytes = {files.sha256(view.image): view for view in reference if view.image.is_file()}
    by_name = {view.name: view for view in reference}
    found = []
    for view in views:
        same = by_bytes.get(files.sha256(view.image)) if view.image.is_file() else None
        same = same or by_name.get(view.name)
        if same is not None:
            found.append((view, same))
    return found


def _degrees(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.rad2deg(pose.rotation_angle(np.swapaxes(first, 1, 2) @ second))
