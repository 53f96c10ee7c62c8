"""Drawings of a plan: a picture for a report, and a self-contained page that shows it in three dimensions."""

import json
from importlib.resources import files as package_files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.shapes.solids import Solid
from koala3d.capture.planning.obstacles import Obstacles
from koala3d.capture.planning.paths import least_margin
from koala3d.capture.planning.plan import PlannedView
from koala3d.datasets.core import files

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {"train": "#1f77b4", "test": "#d62728", "calibration": "#2ca02c"}
"""Colour of the views of each split."""
FRUSTUM_M = 0.05  # length of the pyramid that represents a camera
SHARP_RAD, MOST_EDGES = 0.15, 2000
"""Angle between two triangles from which on their common edge is drawn, and how many edges of a body are drawn."""
STEPS = 24  # points on the path of the camera from each view to the next


def _cameras(planned: list[PlannedView], obstacles: Obstacles) -> NDArray[np.float64]:
    """(n, 4, 4) camera poses at the planned joint angles [m]."""
    return obstacles.carrier.base_from_camera(np.stack([view.joints for view in planned]))


def _paths(planned: list[PlannedView]) -> list[NDArray[np.float64]]:
    """(STEPS, n) joint angles from each view to the next, through all corners."""
    paths, before = [], planned[0].joints
    for view in planned[1:]:
        corners = np.array([before, *view.path])
        length = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners, axis=0)).max(axis=1))])
        share = np.linspace(0.0, max(length[-1], 1e-9), STEPS)
        paths.append(np.stack([np.interp(share, length, corners[:, joint]) for joint in range(len(before))], axis=-1))
        before = view.joints
    return paths


def pyramid(base_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """(8, 2, 3) edges of a small view frustum [m]."""
    half = 0.6 * FRUSTUM_M
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    corners = np.column_stack([signs * [half, half * 0.6], np.full(4, FRUSTUM_M)])
    tip = np.zeros(3)
    edges = [(tip, corner) for corner in corners] + [(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    return np.array(edges) @ base_from_camera[:3, :3].T + base_from_camera[:3, 3]


def _box_edges(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(12, 2, 3) edges of the axis-aligned box between (2, 3) corners [m]."""
    places = np.array([[corners[a, 0], corners[b, 1], corners[c, 2]] for a in (0, 1) for b in (0, 1) for c in (0, 1)])
    pairs = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    return np.array([(places[a], places[b]) for a, b in pairs])


def _outline_edges(solid: Solid) -> NDArray[np.float64]:
    """(n, 2, 3) edges of a body [m]: its sharp ones, and of a body with none all, up to `MOST_EDGES`."""
    import trimesh

    mesh = trimesh.Trimesh(*solid.outline(), process=False)
    sharp = mesh.face_adjacency_edges[mesh.face_adjacency_angles > SHARP_RAD]
    edges = sharp if len(sharp) else mesh.edges_unique
    return np.asarray(mesh.vertices[edges[:: max(len(edges) // MOST_EDGES, 1)]], np.float64)


def plot(planned: list[PlannedView], obstacles: Obstacles, path: Path, *, title: str) -> None:
    """Write a PNG: views and paths from the side and from above, and the joint angles along the session."""
    figure = figure_of(planned, obstacles, title=title)
    with files.atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=100)


def figure_of(planned: list[PlannedView], obstacles: Obstacles, *, title: str) -> "Figure":
    """The figure that `plot` writes, with a legend below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 5.6), layout="constrained")
    panels = figure.subplots(1, 3)
    _side(panels[0], planned, obstacles, (0, 2))
    _side(panels[1], planned, obstacles, (0, 1))
    panels[0].set(xlabel="side view: x [m]", ylabel="z [m]")
    panels[1].set(xlabel="top view: x [m]", ylabel="y [m]")
    angles = np.degrees(np.stack([view.joints for view in planned]))
    panels[2].plot(angles, marker=".", label=[f"joint {joint}" for joint in range(1, angles.shape[1] + 1)])
    panels[2].set(xlabel="view, in the order of capture", ylabel="joint angle [degrees]")
    panels[2].legend(ncols=2, fontsize="small")
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower left", ncols=len(names), fontsize="small", frameon=False)
    figure.suptitle(title)
    return figure


def _side(panel: "Axes", planned: list[PlannedView], obstacles: Obstacles, axes: tuple[int, int]) -> None:
    """Cameras, paths, arm, box, table and ceiling, projected on two axes of the base. The first of each kind is labelled."""
    across, up = axes
    for index, path in enumerate(_paths(planned)):
        track = _camera_track(path, obstacles)
        label = "" if index else "path of the camera"
        panel.plot(track[:, across], track[:, up], color="0.8", linewidth=0.8, zorder=1, label=label)
    arm = {"color": "0.4", "alpha": 0.35, "solid_capstyle": "round"}
    parts = zip(obstacles.carrier.segments(planned[0].joints), obstacles.shape.radii, strict=True)
    for index, (ends, radius) in enumerate(parts):
        label = "" if index else "arm at the first view"
        panel.plot(ends[:, across], ends[:, up], linewidth=60 * radius, label=label, **arm)
    if obstacles.object_corners is not None:
        for index, edge in enumerate(_box_edges(obstacles.object_corners)):
            panel.plot(edge[:, across], edge[:, up], color="goldenrod", linewidth=1, label="" if index else "box of the object")
    for index, solid in enumerate(obstacles.carrier.solids):
        edges = _outline_edges(solid)[..., [across, up]]
        corners = np.concatenate([edges, np.full_like(edges[:, :1], np.nan)], axis=1).reshape(-1, 2)  # a gap after each edge
        panel.plot(*corners.T, color="rosybrown", linewidth=0.8, label="" if index else "other bodies")
    planes = {"table": (obstacles.table_z, "sienna"), "ceiling": (obstacles.ceiling_z, "slategray")}
    for name, (z, colour) in planes.items() if up == 2 else ():
        if z is not None:
            panel.axhline(z, color=colour, label=name)
    splits = [view.viewpoint.split for view in planned]
    for index, (split, pose) in enumerate(zip(splits, _cameras(planned, obstacles), strict=True)):
        ends = np.stack([pose[:3, 3], pose[:3, 3] + FRUSTUM_M * pose[:3, 2]])
        label = f"{splits.count(split)} cameras ({split}) and their view directions" if split not in splits[:index] else ""
        colour = COLOURS.get(split, "black")
        panel.plot(ends[:, across], ends[:, up], color=colour, linewidth=1.5, marker=".", markevery=[0], label=label)
    panel.set(aspect="equal")
    if up == 2 and obstacles.up < 0:
        panel.invert_yaxis()  # the picture is upright, the base hangs


def _camera_track(path: NDArray[np.float64], obstacles: Obstacles) -> NDArray[np.float64]:
    return obstacles.carrier.base_from_carried(path)[:, :3, 3]


def page(planned: list[PlannedView], obstacles: Obstacles, path: Path, *, title: str) -> None:
    """Write one HTML file that shows arm, views and paths in three dimensions and loads nothing."""
    write_page(path, _scene(planned, obstacles, title))


def write_page(path: Path, scene: dict[str, Any]) -> None:
    """Write the page of a scene: `surroundings`, `views`, and the cells that are `swept`."""
    template = (package_files("koala3d.capture") / "planning" / "plan.html").read_text(encoding="utf-8")
    content = json.dumps(scene, separators=(",", ":")).replace("</", "<\\/")
    files.write_text(path, template.replace("/*SCENE*/null", content))


def _scene(planned: list[PlannedView], obstacles: Obstacles, title: str) -> dict[str, Any]:
    """What the page draws, lengths in metres rounded to 0.1 mm."""
    cameras = _cameras(planned, obstacles)
    start = np.repeat(planned[0].joints[None], STEPS, axis=0)
    ends = [planned[0].joints, *(view.joints for view in planned[:-1])]
    rooms = [least_margin(np.array([end, *view.path]), obstacles) for end, view in zip(ends, planned, strict=True)]
    views = [
        {
            **still(view.viewpoint.name, view.joints, obstacles.carrier.segments(path), room),
            "split": view.viewpoint.split,
            "colour": COLOURS.get(view.viewpoint.split, "#000000"),
            "edges": pyramid(pose).round(4).tolist(),
            "track": _camera_track(path, obstacles).round(4).tolist(),
        }
        for view, room, path, pose in zip(planned, rooms, [start, *_paths(planned)], cameras, strict=True)
    ]
    return {**surroundings(obstacles, title), "views": views, "swept": []}


def still(name: str, joints: NDArray[np.float64], arm: NDArray[np.float64], room: float) -> dict[str, Any]:
    """A view of the page: (n,) joint angles [rad], (..., parts, 2, 3) ends of the arm's parts at each step [m], margin [m]."""
    return {
        "name": name,
        "split": "candidate",
        "colour": COLOURS["train"],
        "joints_deg": np.degrees(joints).round(1).tolist(),
        "edges": [],
        "arm": arm.reshape(-1, *arm.shape[-3:]).round(4).tolist(),
        "track": [],
        "room_mm": round(1e3 * float(room), 1),
    }


def surroundings(obstacles: Obstacles, title: str) -> dict[str, Any]:
    """What the page shows around the arm."""
    box = obstacles.object_corners
    return {
        "title": title,
        "radii": obstacles.shape.radii.tolist(),
        "table_z": obstacles.table_z,
        "ceiling_z": obstacles.ceiling_z,
        "up": obstacles.up,
        "box": [] if box is None else _box_edges(box).round(4).tolist(),
        "solids": [_outline_edges(solid).round(4).tolist() for solid in obstacles.carrier.solids],
    }
