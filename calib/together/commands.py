"""The command that calibrates several cameras together: `calib cameras`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from koala3d.calib.options import (
    AllowMm,
    Arm,
    Import,
    Inexact,
    LeaveOut,
    Lens,
    RigOptions,
    allowed_m,
    check_lens,
    spread,
)
from koala3d.datasets.core import console

if TYPE_CHECKING:
    from koala3d.calib.together.cameras import Cameras

BETWEEN = "cameras.json"
FORMAT, VERSION = "koala-cameras", 1


@spread
def cameras(
    recordings: Annotated[
        list[Path], Argument(metavar="RECORDING", help="Folders made by 'capture run', one for each camera; the first counts.")
    ],
    arm: Arm,
    inexact: Inexact,
    out: Annotated[Path, Option("--out", help="Folder to write: a calibration file for each camera, and cameras.json.")],
    same_stops: Annotated[
        bool, Option("--same-stops", help="Views of one name were taken at the same stop of the arm, as a stereo camera does.")
    ] = False,
    description: Import = None,
    leave_out: LeaveOut = False,
    lens: Lens = "auto",
    allow_mm: AllowMm = 5.0,
    json: console.Json = False,
) -> None:
    """Calibrate several cameras on one arm together, and the poses between them.

    All must have seen one target, which nobody has moved. Beside one calibration for each camera, cameras.json holds the pose
    of every camera in the first one's frame, with its uncertainty.
    """
    from koala3d.calib.together.cameras import calibrate_cameras
    from koala3d.datasets.core import files
    from koala3d.datasets.core.errors import UsageError

    check_lens(lens)
    accuracy, allow_m = arm.accuracy(inexact), allowed_m(allow_mm)
    files.refuse_existing(out)
    names = [path.resolve().name for path in recordings]
    if len(set(names)) < len(names):
        raise UsageError(
            "two recordings have the same name", why=", ".join(names), remedy="rename one: files are named after them"
        )
    options = {"description": description, "leave_out": leave_out, "lens": lens}
    sessions = [RigOptions(recording=path, **options).read()[0] for path in recordings]
    found = calibrate_cameras(
        sessions, [str(path) for path in recordings], same_stops=same_stops, accuracy=accuracy, lens=lens, allow_m=allow_m
    )
    content = _content(found, names)
    with files.atomic_folder(out) as folder:
        for name, calibration in zip(names, found.calibrations, strict=True):
            calibration.save(folder / f"{name}.json")
        files.write_json(folder / BETWEEN, {"format": FORMAT, "version": VERSION, **content})
    console.report({"out": str(out), **content}, as_json=json, text=f"{_text(found, names)}\nwritten to {out}")


def _content(found: "Cameras", names: list[str]) -> dict[str, Any]:
    between = {name: value.to_json() for name, value in zip(names[1:], found.first_from_camera, strict=True)}
    return {"cameras": names, "first": names[0], "first_from_camera": between, "stops": found.stops, "shared_stops": found.shared}


def _text(found: "Cameras", names: list[str]) -> str:
    import numpy as np

    lines = []
    for name, calibration in zip(names, found.calibrations, strict=True):
        (title, pose), *_ = calibration.poses.items()
        millimetres, degrees = pose.total_std
        rms = calibration.residuals.rms_px
        lines.append(f"{name:<20} {title} to {millimetres:.3f} mm, {degrees:.4f} deg; {rms:.3f} px rms")
    for name, value in zip(names[1:], found.first_from_camera, strict=True):
        place = ", ".join(f"{one:.2f}" for one in 1e3 * value.matrix[:3, 3])
        distance = 1e3 * float(np.linalg.norm(value.matrix[:3, 3]))
        millimetres, degrees = value.total_std
        lines.append(f"{name} in {names[0]}: ({place}) mm, {distance:.2f} mm away, to {millimetres:.3f} mm, {degrees:.4f} deg")
    lines.append(f"{found.shared} of {found.stops} stops were seen by more than one camera")
    return "\n".join(lines)
