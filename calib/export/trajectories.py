"""Where the camera was in the recording that a calibration was made from: TUM's trajectories, and tables."""

import csv
import io

from koala3d.calib.arrays import Array
from koala3d.calib.export.source import Source, text
from koala3d.calib.origin import recording_of
from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import Frame, Recording

COLUMNS = ("image", "x", "y", "z", "qw", "qx", "qy", "qz")


def tum(source: Source) -> str:
    """A line for each view: time [s], position [m], quaternion with w last."""
    frames, poses = _views(source)
    notes = [
        *source.notes(),
        *_notes(frames),
        "timestamp tx ty tz qx qy qz qw; times are those of the computer's monotonic clock.",
    ]
    lines = [f"# {note}" for note in notes]
    for frame, matrix in zip(frames, poses, strict=True):
        w, x, y, z = pose.quaternion(matrix)
        lines.append(f"{frame.host_time_ns * 1e-9:.9f} {text(*matrix[:3, 3], x, y, z, w)}")
    return "\n".join(lines) + "\n"


def table(source: Source) -> str:
    """The same as CSV, by the name of the image."""
    frames, poses = _views(source)
    out = io.StringIO(newline="")
    for note in (*source.notes(), *_notes(frames)):
        out.write(f"# {note}\n")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for frame, matrix in zip(frames, poses, strict=True):
        writer.writerow([frame.image.rpartition("/")[2], *map(repr, map(float, (*matrix[:3, 3], *pose.quaternion(matrix))))])
    return out.getvalue()


def _views(source: Source) -> tuple[list[Frame], Array]:
    """The frames of the recording and their (n, 4, 4) world_from_camera [m]. Raises UsageError if there are none."""
    if not source.on_flange:
        source.pose()
        why, remedy = "the camera stands beside the arm", "export its one pose: --to urdf, or another that holds a pose"
        raise UsageError("there is no trajectory", where=source.path, why=why, remedy=remedy)
    frames = Recording.open(recording_of(source.calibration, source.recording)).frames
    return frames, source.calibration.camera_poses(frames)


def _notes(frames: list[Frame]) -> list[str]:
    turned = any(frame.turntable_angle for frame in frames)
    world = "the frame of the object on the turntable" if turned else "the base of the arm's controller"
    return [f"A pose takes coordinates in the camera (x right, y down, z forward) to {world}."]
