"""Draws the conventions (frames of the rig, camera axes, pixels, a ray) with the functions that the programs use."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning import plan
from koala3d.capture.sim.laboratory.scenes import stage
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import OPENCV_FROM_LLFF, OPENCV_FROM_OPENGL
from koala3d.datasets.kinematics import link_frames
from koala3d.datasets.process.world.similarity import Similarity, between

Array = NDArray[np.float64]
SESSION = Path(__file__).parent.parent / "configs" / "trajectories" / "calibration_demo.yaml"
VIEW = 14
"""The view of the session at which the arm is drawn."""
CURVE = Path(__file__).parent / "curve.csv"
"""Trainings of budgets of seconds, by `tests.bench.curve`."""
PUBLISHED = {"instant-ngp": (161, 35.65), "3DGS": (360, 35.70), "NeRF": (84_600, 32.86)}
"""Published seconds on one GPU and PSNR [dB] of `lego` at 800×800."""
AXES = ("#c33", "#292", "#33c")
"""x red, y green, z blue."""
DPI = 110


def draw_all(out: Path) -> list[Path]:
    """Write every drawing into a folder; returns their paths."""
    made = []
    drawings: dict[str, Callable[[], Figure]] = {
        "frames": frames,
        "axes": camera_axes,
        "pixels": pixels,
        "ray": ray,
        "turned": turned,
        "curve": curve,
    }
    for name, draw in drawings.items():
        figure = draw()
        figure.savefig(out / f"{name}.png", dpi=DPI, bbox_inches="tight", pad_inches=0.1, metadata={"Software": None})
        made.append(out / f"{name}.png")
    return made


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def _triad(axes: Any, base_from_thing: Array, name: str, length: float, *, away: tuple[float, float, float]) -> None:
    """Three coloured axes at a pose, with the frame's name beside them."""
    origin = base_from_thing[:3, 3]
    for column, colour in enumerate(AXES):
        tip = origin + length * base_from_thing[:3, column]
        axes.plot(*np.stack([origin, tip], 1), color=colour, linewidth=2.5, zorder=10)
        axes.text(
            *(origin + 1.25 * length * base_from_thing[:3, column]),
            "xyz"[column],
            color=colour,
            fontsize=8,
            ha="center",
            va="center",
        )
    axes.text(*(origin + np.asarray(away)), name, fontsize=12, weight="bold", ha="center")


def _arrow(axes: Any, start: Array, end: Array, words: str, shift: tuple[float, float, float]) -> None:
    """A dashed way from one origin to another with the transform's name in its middle."""
    axes.plot(*np.stack([start, end], 1), color="#666", linestyle="--", linewidth=1.2)
    axes.text(*((start + end) / 2 + np.asarray(shift)), words, fontsize=9.5, color="#333", ha="center", family="monospace")


def frames() -> Figure:
    """Base, flange, camera and board of the rig with the transforms between them."""
    figure = _figure(9, 6.4)
    axes: Any = figure.add_axes((0.0, -0.06, 1.0, 1.16), projection="3d", computed_zorder=False)
    session, mount = load_trajectory(SESSION), RigDescription().carrier()
    joints, target = plan(session, mount)[VIEW].joints, session.target
    assert session.board is not None and target is not None
    base_from_flange, base_from_board = link_frames(joints)[-1], session.board.matrix()
    base_from_camera = base_from_flange @ mount
    for start, end in mount.segments(joints):
        axes.plot(*np.stack([start, end], 1), color="#c8d2dc", linewidth=11, solid_capstyle="round", zorder=1)
    width, height = (count * target.square_length_m for count in (target.squares_x, target.squares_y))
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height), (0, 0)])
    board = (base_from_board @ np.column_stack([corners, np.zeros(5), np.ones(5)]).T)[:3]
    axes.plot(*board, color="#555", linewidth=1.5)
    _frustum(axes, base_from_camera)
    origins = [matrix[:3, 3] for matrix in (np.eye(4), base_from_flange, base_from_camera, base_from_board)]
    _triad(axes, np.eye(4), "base", 0.12, away=(-0.08, -0.08, 0.0))
    _triad(axes, base_from_flange, "flange", 0.08, away=(0.13, 0.0, -0.05))
    _triad(axes, base_from_camera, "camera", 0.08, away=(-0.1, 0.0, 0.05))
    _triad(axes, base_from_board, "board", 0.08, away=(0.12, 0.0, -0.06))
    _arrow(axes, origins[0], origins[1], "base_from_flange", (-0.08, 0.0, 0.1))
    _arrow(axes, origins[1], origins[2], "flange_from_camera", (-0.05, 0.0, 0.1))
    _arrow(axes, origins[2], origins[3], "camera_from_board", (0.22, 0.08, -0.03))
    _arrow(axes, origins[0], origins[3], "base_from_board", (0.0, 0.0, -0.05))
    axes.set(xlim=(-0.15, 0.75), ylim=(-0.3, 0.35), zlim=(-0.02, 0.63))
    axes.set_box_aspect((0.9, 0.65, 0.65), zoom=1.3)
    axes.view_init(elev=16, azim=-62)
    axes.set_axis_off()
    return figure


def _frustum(axes: Any, base_from_camera: Array, depth: float = 0.1) -> None:
    camera = Camera(960, 540, 635.0, 635.0, 480.0, 270.0)
    corners = np.array([(0, 0), (960, 0), (960, 540), (0, 540), (0, 0)], float)
    far = depth * camera.directions(corners)
    placed = (base_from_camera @ np.column_stack([far, np.ones(5)]).T)[:3].T
    axes.plot(*placed.T, color="#1f77b4", linewidth=1)
    for corner in placed[:4]:
        axes.plot(*np.stack([base_from_camera[:3, 3], corner], 1), color="#1f77b4", linewidth=1)


def camera_axes() -> Figure:
    """The same camera with the axes of three conventions."""
    figure = _figure(9, 3.3)
    # plotted as (right, forward, up) so that the page's up is up
    plot_from_camera = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    kinds = {"OpenCV, Koala": np.eye(3), "OpenGL, Blender": OPENCV_FROM_OPENGL[:3, :3], "LLFF": OPENCV_FROM_LLFF[:3, :3]}
    for index, (title, camera_from_axes) in enumerate(kinds.items(), 1):
        axes: Any = figure.add_subplot(1, 3, index, projection="3d", computed_zorder=False)
        camera = Camera(4, 3, 4.0, 4.0, 2.0, 1.5)
        corners = plot_from_camera @ (0.9 * camera.directions(np.array([(0, 0), (4, 0), (4, 3), (0, 3), (0, 0)], float))).T
        axes.plot(*corners, color="#777")
        for corner in corners.T[:4]:
            axes.plot(*np.stack([np.zeros(3), corner], 1), color="#777", linewidth=1)
        for column, colour in enumerate(AXES):
            tip = plot_from_camera @ camera_from_axes[:, column]
            axes.quiver(0, 0, 0, *tip, color=colour, linewidth=2.5, arrow_length_ratio=0.15)
            axes.text(*(1.2 * tip), "xyz"[column], color=colour, fontsize=12, weight="bold", ha="center", va="center")
        axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
        axes.set_box_aspect((1, 1, 1), zoom=1.2)
        axes.view_init(elev=22, azim=-48)
        axes.set_axis_off()
        axes.set_title(title, fontsize=12, y=-0.04)
    figure.subplots_adjust(0, 0, 1, 0.95, 0, 0)
    return figure


def pixels() -> Figure:
    """Where pixels are: a picture of four by three, with coordinates of edges and centres."""
    figure = _figure(6.4, 4.3)
    axes = figure.add_axes((0.1, 0.08, 0.86, 0.8))
    camera = Camera(4, 3, 4.0, 4.0, 2.0, 1.5)
    centres = camera.pixel_centres().reshape(-1, 2)
    for column in range(5):
        axes.plot([column, column], [0, 3], color="#999", linewidth=1)
    for row in range(4):
        axes.plot([0, 4], [row, row], color="#999", linewidth=1)
    axes.plot(*centres.T, "o", color="#1f77b4", markersize=5)
    for x, y in centres[[0, 1, 4, 11]]:
        axes.text(x, y + 0.3, f"({x:g}, {y:g})", ha="center", fontsize=10)
    axes.plot(2, 1.5, "+", color="#c33", markersize=14, markeredgewidth=2)
    axes.text(2.08, 1.42, "cx, cy = (2, 1.5)", color="#c33", fontsize=10)
    axes.set(xlim=(-0.15, 4.15), ylim=(3.15, -0.15), aspect="equal", xticks=range(5), yticks=range(4))
    axes.xaxis.tick_top()
    axes.set_xlabel("x: columns, width 4", fontsize=11)
    axes.set_ylabel("y: rows, height 3", fontsize=11)
    axes.spines[:].set_visible(False)
    return figure


def ray() -> Figure:
    """One ray from above: what is depth, what is distance, what is the cone's radius."""
    figure = _figure(7.6, 3.3)
    axes = figure.add_axes((0.02, 0.02, 0.96, 0.96))
    camera = Camera(8, 6, 7.0, 7.0, 4.0, 3.0)
    slope = float(camera.directions(np.array([[7.5, 3.0]]))[0, 0])
    t, radius = 3.2, 0.11
    axes.annotate("", (3.9, 0), (0, 0), arrowprops={"arrowstyle": "->", "color": AXES[2], "linewidth": 2})
    axes.text(3.95, -0.02, "z", color=AXES[2], fontsize=12, weight="bold", va="center")
    axes.annotate("", (0, 1.0), (0, 0), arrowprops={"arrowstyle": "->", "color": AXES[0], "linewidth": 2})
    axes.text(-0.02, 1.08, "x", color=AXES[0], fontsize=12, weight="bold", ha="center")
    axes.plot([0, 3.7], [0, 3.7 * slope], color="#333", linewidth=1.5)
    axes.fill([0, 3.7, 3.7], [0, 3.7 * (slope + radius), 3.7 * (slope - radius)], color="#1f77b4", alpha=0.15, linewidth=0)
    axes.plot([1, 1], [-0.28, slope], color="#888", linestyle=":", linewidth=1)
    axes.plot([t, t], [-0.6, t * slope], color="#888", linestyle=":", linewidth=1)
    axes.plot(1, slope, "o", color="#333")
    axes.plot(t, t * slope, "o", color="#c60", markersize=8)
    axes.annotate("", (1, -0.22), (0, -0.22), arrowprops={"arrowstyle": "<->", "color": "#555"})
    axes.text(0.5, -0.42, "t = 1", ha="center", fontsize=10)
    axes.annotate("", (t, -0.55), (0, -0.55), arrowprops={"arrowstyle": "<->", "color": "#555"})
    axes.text(t / 2, -0.78, "depth = t", ha="center", fontsize=11)
    axes.text(0.6, slope + 0.18, "directions (z = 1)", fontsize=10, ha="right", rotation=0)
    axes.text(t - 0.15, t * slope + 0.32, "distance = t · norm(directions)", fontsize=11, ha="right")
    axes.annotate("radii: half-width at t = 1", (1.0, slope - radius), (1.35, 0.12), fontsize=10,
                  arrowprops={"arrowstyle": "-", "color": "#1f77b4"}, color="#1f77b4")  # fmt: skip
    axes.set(xlim=(-0.35, 4.2), ylim=(-0.95, 2.25), aspect="equal")
    axes.set_axis_off()
    return figure


def turned() -> Figure:
    """Two sessions of the simulated mug, upright and turned over, and both in the frame of the first."""
    figure = _figure(10, 3.6)
    session = load_trajectory(SESSION.with_name("koala_demo.yaml"))
    cameras = [one.camera_pose(RigDescription().carrier()) for one in session.viewpoints()][::2]
    meshes = [
        stage("mug", centre=(0.4, 0, 0.15), size=(0.26, 0.26, 0.3), seed=0, pose=lying).mesh() for lying in ("upright", "under")
    ]
    moved = between(meshes[1].vertices, meshes[0].vertices)
    panels = (("first session", 0, [("#2f6fde", Similarity())]), ("turned over", 1, [("#d0342c", Similarity())]))
    both = ("merged", 0, [("#2f6fde", Similarity()), ("#d0342c", moved)])
    for number, (title, which, sessions) in enumerate((*panels, both)):
        axes: Any = figure.add_axes((number / 3, -0.12, 1 / 3, 1.2), projection="3d", computed_zorder=False)
        mesh = meshes[which]
        axes.plot_trisurf(*mesh.vertices.T, triangles=mesh.faces, color="#c8d2dc", shade=True, linewidth=0)
        for colour, motion in sessions:
            for camera in cameras:
                start = motion.points(camera[:3, 3])
                end = motion.points(camera[:3, 3] + 0.05 * camera[:3, 2])
                axes.plot(*np.stack([start, end], 1), color=colour, linewidth=1.2)
                axes.plot(*start[:, None], "o", color=colour, markersize=3)
        axes.set(xlim=(0.05, 0.75), ylim=(-0.35, 0.35), zlim=(-0.3, 0.4))
        axes.set_title(title, y=0.95)
        axes.set_axis_off()
        axes.view_init(elev=14, azim=-60)
    return figure


def curve() -> Figure:
    """PSNR against seconds of training on two cores, with published trainings on GPUs beside it."""
    with CURVE.open() as table:
        rows = list(csv.DictReader(table))
    figure = _figure(7.5, 4.2)
    axes: Any = figure.add_subplot()
    for scene, width in sorted({(row["scene"], int(row["width_px"])) for row in rows}):
        own = [row for row in rows if (row["scene"], int(row["width_px"])) == (scene, width)]
        seconds, psnr = ([float(row[name]) for row in own] for name in ("training_s", "psnr_db"))
        axes.plot(seconds, psnr, marker="o", markersize=4, label=f"{scene}, {width}×{width}, 2 cores")
    axes.plot(*zip(*PUBLISHED.values(), strict=True), "k^", markersize=5, label="lego, 800×800, one GPU, published")
    for (name, place), side in zip(PUBLISHED.items(), ("right", "left", "center"), strict=True):
        axes.annotate(name, place, xytext=(0, -12), textcoords="offset points", fontsize=8, ha=side)
    axes.set(xscale="log", xlabel="seconds of training", ylabel="PSNR of test views [dB]", xlim=(3, 5e5))
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8, loc="lower right")
    return figure
