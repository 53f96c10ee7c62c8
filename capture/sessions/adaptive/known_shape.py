"""Views of a known shape: few within reach that cover its surface, and how far given views cover it.

As in a session that chooses its views, new directions onto the surface count as well. What it looks like is not known, so all of
it is taken to change its colour with direction a little.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.model.viewpoints import CameraPose, PoseViews, Viewpoint
from koala3d.capture.planning import Obstacles
from koala3d.capture.sessions.adaptive import gain
from koala3d.capture.sessions.adaptive.candidates import ReachableView, dense, see, seen_from, within_reach
from koala3d.capture.sessions.adaptive.gain import ENOUGH, Coverage, Seen
from koala3d.capture.sessions.adaptive.loop import ANGLES, LEAST, MOST
from koala3d.capture.sessions.adaptive.places import Places, of_mesh
from koala3d.capture.sessions.adaptive.shape import UNKNOWN
from koala3d.capture.sessions.adaptive.sight import Eye
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.meshes import read_mesh

Array = NDArray[np.float64]

PLACES = 20_000
"""Places on the surface of a mesh."""
ON_TABLE_M, DOWN = 0.003, -0.9
"""Surface so near to the table, whose normal has so much of the downward direction, is what the object stands on."""
ROOM_M = 0.005
"""A mesh may be this far outside the object's box: reconstructions are not exact."""
DIGITS = 6
"""Poses are written to a micrometre."""


@dataclass(frozen=True, eq=False)
class Cover:
    """Views that cover a shape."""

    trajectory: Trajectory
    coverage: Coverage
    candidates: int
    """Number of views that were chosen from."""


def surface_of(path: Path, trajectory: Trajectory, scale: float = 1.0) -> Places:
    """Places on a mesh in the base frame, without what it stands on.

    Args:
        scale: metres per unit of the file.

    Raises UsageError: the file is no mesh, or the mesh is not inside the object's box.
    """
    vertices, faces = read_mesh(path, scale)
    if trajectory.object is not None:
        low, high = trajectory.object.corners
        found = np.stack([vertices.min(0), vertices.max(0)])
        beyond = float(np.maximum(low - found[0], found[1] - high).max())
        if beyond > ROOM_M:
            why = (
                f"it reaches from {np.round(found[0], 3).tolist()} to {np.round(found[1], 3).tolist()} m, {beyond:.3f} m outside"
            )
            remedy = "move it to where the object stands in the base frame; --mesh-scale 0.001 if it is in millimetres"
            raise UsageError("the mesh is not inside the object's box", where=path, why=why, remedy=remedy)
    places = of_mesh(vertices, faces, PLACES)
    up, table = trajectory.upwards, trajectory.safety.table_z
    if table is None:
        return places
    stands = (np.abs(places.points[:, 2] - table) < ON_TABLE_M) & (up * places.normals[:, 2] < DOWN)
    kept = ~stands
    return Places.of(places.points[kept], places.normals[kept], places.shares[kept], places.spacing)


def cover(
    trajectory: Trajectory,
    carrier: Carrier,
    places: Places,
    *,
    eye: Eye,
    camera: Camera | None,
    until: float = 1.0,
    views: int = MOST,
    done: Callable[[], None] = lambda: None,
) -> Cover:
    """A trajectory of few views within reach that cover a shape, found greedily; its test views are kept.

    Args:
        eye: where the camera is when the flange is somewhere.
        camera: with the size of the pictures; None: these show all of the object.
        until: wanted share of the surface within reach, from 0 to 1.
        views: largest number of training views.
        done: called after each view whose reach was examined.

    Raises UsageError: none of the views can be taken.
    """
    obstacles = Obstacles.of(trajectory, carrier)
    candidates, reasons = within_reach(dense(trajectory), obstacles, done)
    if not candidates:
        raise UsageError(
            "no view within reach", where=trajectory.name, why=reasons[0] if reasons else "", remedy="see 'capture plan'"
        )
    seen = see(candidates, places, obstacles, eye, camera)
    chosen = greedy(places, seen, until, views)
    taken = Seen(seen.facing[chosen], seen.eyes[chosen])
    groups = [*_groups([candidates[index].solutions.viewpoint for index in chosen], None)]
    tests = [one.solutions.viewpoint for one in _tests(trajectory, obstacles)]
    if tests:
        groups = [group.model_copy(update={"use": "train"}) for group in groups] + _groups(tests, "test")
    motion = trajectory.motion.model_copy(update={"order": "shortest"})
    update = {"name": f"{trajectory.name}_for_mesh", "views": groups, "split": None, "motion": motion}
    return Cover(trajectory.model_copy(update=update), gain.coverage(places, taken, seen), len(candidates))


def greedy(places: Places, seen: Seen, until: float, views: int) -> list[int]:
    """Indices of views, each the one that adds most, until `until` of the surface is covered or no view shows more of it."""
    chosen: list[int] = []
    left = np.ones(len(seen.eyes), bool)
    nearest = np.full(seen.facing.shape, -1.0, np.float32)
    changing = np.full(len(places.points), UNKNOWN)
    ways = gain.directions(places.points, seen.eyes)
    while len(chosen) < views:
        taken = Seen(seen.facing[chosen], seen.eyes[chosen])
        if gain.coverage(places, taken, seen).covered >= until:
            break
        surface = np.where(left, gain.surface_gains(places, taken, seen), 0.0)
        if surface.max() < LEAST:
            break
        angles = np.where(left, gain.angle_gains(places, changing, taken, seen, nearest), 0.0)
        best = int((surface + ANGLES * angles).argmax())
        chosen.append(best)
        left[best] = False
        np.maximum(nearest, gain.nearest_directions(ways[[best]], seen.well[[best]], ways), out=nearest)
    return chosen


def _tests(trajectory: Trajectory, obstacles: Obstacles) -> list[ReachableView]:
    return within_reach([view for view in trajectory.viewpoints() if view.split == "test"], obstacles)[0]


def _groups(views: list[Viewpoint], use: Literal["train", "test"] | None) -> list[PoseViews]:
    """Views as groups of a trajectory, one for each set of rolls."""
    by_rolls = sorted(views, key=lambda view: view.rolls)
    found = []
    for rolls, group in itertools.groupby(by_rolls, key=lambda view: view.rolls):
        poses = [_described(view.base_from_camera) for view in group if view.base_from_camera is not None]
        roll_deg = np.degrees(rolls).round(DIGITS).tolist()
        found.append(PoseViews.model_validate({"kind": "poses", "poses": poses, "roll_deg": roll_deg, "use": use}))
    return found


def _described(base_from_camera: Array) -> CameraPose:
    position = base_from_camera[:3, 3].round(DIGITS).tolist()
    return CameraPose(position=tuple(position), quaternion_wxyz=tuple(pose.quaternion(base_from_camera).round(9).tolist()))


def covered_after(places: Places, cameras: Array, camera: Camera | None) -> list[float]:
    """Share of a surface that `ENOUGH` of the first 1, 2, ... of (m, 4, 4) base_from_camera poses [m] see well."""
    counts = np.cumsum(seen_from(cameras, places, camera).well, axis=0)
    return [float(places.shares[row >= ENOUGH].sum()) for row in counts]


def write(trajectory: Trajectory, out: Path) -> None:
    """Write a trajectory to the new file `out`."""
    import yaml

    content = trajectory.model_dump(mode="json", exclude_defaults=True)
    content = {"format": trajectory.format, "version": trajectory.version, **content}
    head = f"# Views chosen by 'capture plan --for-mesh': {trajectory.number}.\n"
    files.write_text(out, head + yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120))
