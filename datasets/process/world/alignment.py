"""From a model in its own frame and unit to the world: metres where something tells the size, z up, the origin at the object."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import assemble
from koala3d.datasets.process.pictures import markers
from koala3d.datasets.process.pictures.markers import Marker
from koala3d.datasets.process.world import scale, up
from koala3d.datasets.process.world.scale import KnownLength
from koala3d.datasets.process.world.similarity import Similarity, upwards
from koala3d.datasets.scene import TURNED, Scene
from koala3d.datasets.structure import bounds


@dataclass(frozen=True)
class Wishes:
    """What the user knows about size and up."""

    marker_m: float | None = None
    """Printed side of the markers in view."""
    known: KnownLength | None = None
    positions: Path | None = None
    """File of measured positions."""
    up: str = "auto"
    """One of `up.KINDS`."""

    def __post_init__(self) -> None:
        if sum(wish is not None for wish in (self.marker_m, self.known, self.positions)) > 1:
            raise UsageError("the size is stated twice", remedy="give one of --marker-mm, --known-length, --positions")
        if self.marker_m is not None and not 0 < self.marker_m < np.inf:
            raise UsageError("a marker's side must be positive", where="--marker-mm", why=f"{1000 * self.marker_m:g} mm")


@dataclass(frozen=True, eq=False)
class Aligned:
    """A scene in its world, and what fixed that."""

    scene: Scene
    scale_from: str | None
    """Evidence for the metre; None where the unit is arbitrary."""
    up_from: str | None
    """Evidence for the z axis; None where it was left as it came."""
    hint: str | None = None
    """What would give the scene a unit."""


def align(scene: Scene, seen: Mapping[str, Sequence[Marker]], wishes: Wishes) -> Aligned:
    """Bring a scene without unit and direction to the world, and measure its bounds there.

    Args:
        scene: with points, in any frame.
        seen: the markers in each view's picture, by the view's name.
        wishes: what is known.

    Raises:
        UsageError: what `wishes` promises is not in the pictures.
    """
    placed = markers.place(scene.views, seen)
    if wishes.positions is not None:
        found, scale_from = scale.by_positions(scene.views, scale.read_positions(wishes.positions))
        return Aligned(moved(scene, found, metric=True), scale_from, "the frame of the positions")
    factor, scale_from = 1.0, None
    if wishes.marker_m is not None:
        factor, scale_from = scale.by_markers(placed, wishes.marker_m)
    elif wishes.known is not None:
        factor, scale_from = scale.by_length(scene.views, wishes.known)
    turned, up_from = _upright(scene, placed, wishes.up)
    hint = None
    if scale_from is None and placed:
        hint = f"marker {placed[0].kind} is in {placed[0].seen} pictures: its printed side as --marker-mm gives metres"
    world = Similarity(factor).after(turned)
    return Aligned(moved(scene, world, metric=scene.metric or scale_from is not None), scale_from, up_from, hint)


def _upright(scene: Scene, placed: Sequence[markers.PlacedMarker], kind: str) -> tuple[Similarity, str | None]:
    """The motion that makes z up, with the origin where the cameras look, on the ground where there is one; and the evidence."""
    if kind == "none":
        return Similarity(), None
    matrices = np.stack([view.world_from_camera for view in scene.views])
    origin, spread = bounds.focus(matrices)
    if spread < bounds.PARALLEL and scene.points is not None:
        origin = np.median(scene.points, axis=0)
    direction, evidence = up.by_cameras(scene.views), "the cameras, as pictures are held level"
    by_markers = up.by_markers(placed) if kind in ("auto", "marker") else None
    if kind == "marker" and by_markers is None:
        raise UsageError("up cannot be taken from a marker", where="--up", why="none was found, or they face different ways")
    ground = None
    if by_markers is not None:
        direction, evidence = by_markers
        origin = origin + ((placed[0].corners.mean(0) - origin) @ direction) * direction
    elif kind in ("auto", "plane") and scene.points is not None:
        ground = up.by_plane(scene.views, scene.points, direction)
    if kind == "plane" and ground is None:
        raise UsageError("up cannot be taken from a plane", where="--up", why="no plane below the cameras holds enough points")
    if ground is not None:
        direction, place, share = ground
        origin, evidence = origin + ((place - origin) @ direction) * direction, f"a plane with {100 * share:.0f}% of the points"
    rotation = upwards(direction)
    return Similarity(1.0, rotation, -rotation @ origin), evidence


def _motion_in(world: Similarity, stated: Mapping[str, Any]) -> dict[str, Any]:
    """What a scene states of the motion of an object that was turned over, where both sessions are in another world."""
    a_from_b, middle, covariance = (np.asarray(stated[name]) for name in ("a_from_b", "middle", "covariance"))
    turn, units = world.rotation @ a_from_b[:3, :3] @ world.rotation.T, block_diag(world.scale * world.rotation, world.rotation)
    motion = pose.rigid(turn, world.points(a_from_b[:3, 3]) - turn @ world.translation)
    found = {"a_from_b": motion, "middle": world.points(middle), "covariance": units @ covariance @ units.T}
    return {name: value.tolist() for name, value in found.items()}


def moved(scene: Scene, found: Similarity, *, metric: bool) -> Scene:
    """The scene in another world. Bounds that were stated move along; others are measured anew from masks, points and cameras."""
    views = tuple(replace(found.view(view), truth={}) for view in scene.views)
    points = None if scene.points is None else found.points(scene.points)
    known = dict(scene.provenance)
    if TURNED in known:
        known[TURNED] = {**known[TURNED], **_motion_in(found, known[TURNED])}
    new = replace(scene, views=views, points=points, metric=metric, provenance=known)
    if scene.box_is_stated:
        corners = found.points(bounds.corners(scene.box))
        box = np.stack([corners.min(0), corners.max(0)])
        return replace(new, near=scene.near * found.scale, far=scene.far * found.scale, box=box)
    gathering = assemble.Gathering(Path(scene.name), notes=list(scene.notes))
    measured = assemble.scene(gathering, views, "photographs")
    if points is not None:
        measured = assemble.with_points(measured, points)
    return replace(new, near=measured.near, far=measured.far, box=measured.box, bounds_from=measured.bounds_from)
