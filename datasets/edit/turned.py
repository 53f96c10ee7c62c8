"""One scene of two sessions of an object that was turned over: in the world of the first, without the table of either."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.edit.edit import merge
from koala3d.datasets.process.world.similarity import Similarity, between
from koala3d.datasets.scene import STATED, TURNED, Scene, View
from koala3d.datasets.structure.masks.hull import visual_hull
from koala3d.datasets.structure.masks.silhouette import silhouettes
from koala3d.datasets.turned.registration import Registration

MARGIN = 0.02
"""Of the box around the hull of all masks, on each side: a cell of the hull."""


def by_points(places: ArrayLike) -> NDArray[np.float64]:
    """(4, 4) motion by (n, 6) places of at least three points of the object, in a and in b. UsageError if there is none."""
    points = np.asarray(places, np.float64)
    if points.ndim != 2 or points.shape[1] != 6 or len(points) < 3 or not np.isfinite(points).all():
        raise UsageError("points are not three rows of six numbers", why=f"shape {points.shape}", remedy="x y z in a, x y z in b")
    spans = [np.linalg.svd(side - side.mean(0))[1][1] for side in (points[:, :3], points[:, 3:])]
    if min(spans) < 1e-6:
        raise UsageError("points lie on a line", remedy="give three that form a triangle")
    moved = between(points[:, 3:], points[:, :3])
    if abs(np.log(moved.scale)) > np.log(1.2):
        why = f"the triangle in a is {moved.scale:.2f} times as large as that in b"
        raise UsageError("points are not the same in both scenes", why=why, remedy="look at their order")
    return pose.rigid(moved.rotation, points[:, :3].mean(0) - moved.rotation @ points[:, 3:].mean(0))


def by_surfaces(file: Path) -> Registration:
    """The motion that comparing the surfaces of both sessions found; no outlines were compared, so its misfit is 0.

    Args:
        file: shape.json of `reconstruct compare-shape B A --align features`.

    Raises:
        DatasetError: the file is damaged or none of these.
        UsageError: the surfaces fit in several poses, or B was not moved, or its size was changed.
    """
    content, remedy = files.read_json(file, kind="koala-shape", version=1), "reconstruct compare-shape B A --align features"
    try:
        found = content["aligned"]
        if found["by"] == "base" or found["scale_removed"]:
            why = "the difference in size was removed" if found["scale_removed"] else "B was left where it stands"
            raise UsageError("is no motion of an object", where=file, why=why, remedy=remedy)
        if found["ambiguous"]:
            why = "another pose of the surfaces fits as well"
            raise UsageError("how the object was turned cannot be told", where=file, why=why, remedy="give --points")
        motion = pose.checked(found["matrix"], where=f"{file}, matrix")
        moved = Registration.from_json({**found, "a_from_b": motion, "misfit_px": 0})
        least = np.linalg.eigvalsh(moved.covariance)[0]
        if not (np.isfinite(moved.middle).all() and least >= -1e-9 * np.trace(moved.covariance)):
            raise ValueError("not finite, or with a negative variance")
    except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
        raise DatasetError("states no motion with its covariance", where=file, why=str(error), remedy=remedy) from None
    return moved


def joined(a: Scene, b: Scene, found: Registration, name: str) -> Scene:
    """All views of both sessions, those of b moved to the world of a, and the box of what the masks of both leave.

    Sparse points are left out, since they are of the table as much as of the object; so are the normals of b's truth.
    """
    a, b = _in_room(a), _in_room(b)
    motion = Similarity(1.0, found.a_from_b[:3, :3], found.a_from_b[:3, 3])
    views = tuple(_without_normals(motion.view(view)) for view in b.views)
    plain = [replace(scene, points=None, colours=None, sightings=None) for scene in (a, replace(b, views=views, box=a.box))]
    both = merge(plain, name)
    names = [view.name for view in both.views[len(a.views) :]]
    turned: dict[str, Any] = {**found.to_json(), "views": names}
    shift, turn = found.deviations
    angle = np.rad2deg(pose.rotation_angle(found.a_from_b))
    said = (
        f"{b.name} shows the object turned over, by {angle:.1f} degrees; that is known to "
        f"{1e3 * shift:.2g} {'mm' if a.metric else 'thousandths of a unit'} and {np.rad2deg(turn):.2g} degrees"
    )
    hull = visual_hull(silhouettes(both.views), a.box)
    margin = MARGIN * np.ptp(hull.box, axis=0)
    return replace(
        both,
        box=hull.box + np.stack([-margin, margin]),
        lamps=a.lamps if a.lamps == b.lamps else None,
        notes=(*dict.fromkeys(both.notes), said),
        provenance={**both.provenance, TURNED: turned},
        bounds_from=f"{STATED} by the masks of both sessions",
    )


def _in_room(scene: Scene) -> Scene:
    """The scene with the object's place in each view. Lamps of which nobody says anything are taken to stand in the room."""
    views = tuple(replace(v, base_from_world=np.eye(4)) if v.base_from_world is None else v for v in scene.views)
    if scene.lamps is not None:
        return replace(scene, views=views)
    note = "nobody says what the lamps stand on; they are taken to stand in the room, in which the object was turned over"
    return replace(scene, views=views, lamps="room", notes=(*scene.notes, note))


def _without_normals(view: View) -> View:
    return replace(view, truth={channel: path for channel, path in view.truth.items() if channel != "normals"})
