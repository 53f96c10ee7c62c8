"""A recording for Rerun's viewer: the arm at each view as capsules, its flange, the camera with its picture, table and object.

The clock is that of the arm's controller; `view` counts the views.
"""

from pathlib import Path

import numpy as np

from koala3d.capture.model.rig import recorded_carrier
from koala3d.capture.model.trajectory import recorded_trajectory
from koala3d.capture.page.timeline import of_recording
from koala3d.capture.planning import Obstacles
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.recording import Recording
from koala3d.datasets.reports.rerun_file import RerunFile, rerun_file

ARM, CARRIED, TABLE, OBJECT, SOLID, PATH = (
    (170, 178, 190),
    (50, 50, 60),
    (205, 185, 160),
    (190, 150, 30),
    (190, 120, 90),
    (150, 150, 150),
)  # sRGB
HALF_FIELD = 0.35  # tangent of half the field of view: a recording does not know its lens
TABLE_M, THICK_M = 1.6, 0.01


def write(path: Path, out: Path) -> None:
    """Write a recording, complete or not, as a new file `out`.

    Raises UsageError: `path` holds no recording.
    """
    recording = Recording.open(path)
    trajectory, carrier = recorded_trajectory(recording), recorded_carrier(recording)
    timeline, obstacles = of_recording(recording, carrier), Obstacles.of(trajectory, carrier)
    with rerun_file(out, trajectory.name) as shown:
        shown.text("session", f"# {trajectory.name}\n\n" + "\n".join(f"- {note}" for note in timeline.notes))
        _surroundings(shown, obstacles)
        if not timeline.stops:
            return
        _parts(shown, obstacles, timeline.joints[0])
        settings = trajectory.camera
        focal = 0.5 * settings.width / HALF_FIELD
        camera = Camera(settings.width, settings.height, focal, focal, settings.width / 2, settings.height / 2)
        shown.camera("base/camera", camera)
        shown.line("base/path", [stop.base_from_camera[:3, 3] for stop in timeline.stops], PATH, always=True)
        frames = {frame.name: frame for frame in recording.frames}
        for number, stop in enumerate(timeline.stops):
            frame = frames[stop.name]
            shown.at(view=number)
            shown.at_second(frame.robot_time_s - frames[timeline.stops[0].name].robot_time_s)
            _arm(shown, obstacles, frame.joints)
            shown.frame("base/flange", frame.base_from_flange, axes_m=0.08)
            shown.frame("base/camera", stop.base_from_camera)
            shown.picture("base/camera/picture", recording.image_path(frame), camera)
            shown.numbers("measured", {"exposure_us": frame.exposure_us, "settle_s": frame.settle_s})


def _surroundings(shown: RerunFile, obstacles: Obstacles) -> None:
    """Base, table, ceiling, object and what stands around."""
    shown.frame("base", np.eye(4), always=True, axes_m=0.15)
    for name, z, side in (("table", obstacles.table_z, -obstacles.up), ("ceiling", obstacles.ceiling_z, obstacles.up)):
        if z is not None:
            low = np.array([0.3 - TABLE_M / 2, -TABLE_M / 2, min(z, z + side * THICK_M)])
            shown.box(f"base/{name}", [low, np.add(low, [TABLE_M, TABLE_M, THICK_M])], TABLE)
    if obstacles.object_corners is not None:
        shown.box("base/object", obstacles.object_corners, OBJECT)
    for solid in obstacles.carrier.solids:
        vertices, faces = solid.outline()
        colours = np.tile(SOLID, (len(vertices), 1)).astype(np.uint8)
        shown.mesh(f"base/obstacles/{solid.name}", vertices, faces, colours=colours, always=True)


def _parts(shown: RerunFile, obstacles: Obstacles, joints: np.ndarray) -> None:
    """One capsule for each part of the arm; `_arm` moves it into place."""
    ends = obstacles.carrier.segments(joints)
    for part, length in zip(obstacles.shape.parts, np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1), strict=True):
        shown.capsule(f"base/arm/{part.name}", float(length), part.radius, ARM if part.can_hide else CARRIED)


def _arm(shown: RerunFile, obstacles: Obstacles, joints: np.ndarray) -> None:
    """Where each part is at (n,) joint angles [rad]."""
    for part, (start, end) in zip(obstacles.shape.parts, obstacles.carrier.segments(joints), strict=True):
        along = end - start
        turned = pose.look_at((0, 0, 0), along) if np.linalg.norm(along) > 1e-9 else np.eye(4)
        shown.frame(f"base/arm/{part.name}", pose.rigid(turned[:3, :3], start))
