"""The command `coverage`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from koala3d.capture.cli.options import CalibrationFile, MeshScale, RigName, Settings
from koala3d.datasets.core import console

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from koala3d.capture.model.carrier import Carrier
    from koala3d.capture.model.trajectory import Trajectory
    from koala3d.datasets.calibration import Calibration
    from koala3d.datasets.camera_model import Camera

STEP = 10  # the text has a line for every so many views


def coverage(
    path: Annotated[
        Path, Argument(metavar="TRAJECTORY|RECORDING", help="Name or file of a trajectory, or folder of a recording.")
    ],
    mesh: Annotated[Path, Option("--mesh", metavar="MESH", help="The object's shape in the base frame.")],
    mesh_scale: MeshScale = 1.0,
    rig: RigName = "sim",
    calibration: CalibrationFile = None,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Measure how far views cover a shape: the share of its surface that three training views see at 60 degrees or less.

    Views are counted in the order in which they are taken. What the object stands on is left out.
    """
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.rig.naming import describe
    from koala3d.capture.sessions.adaptive.known_shape import covered_after, surface_of
    from koala3d.datasets.calibration import Calibration

    known = None if calibration is None else Calibration.load(calibration)
    if path.is_dir():
        session, cameras, camera = _recorded(path, known)
    else:
        session = load_trajectory(path, overrides=settings)
        cameras, camera = _planned(session, describe(rig).carrier(), known)
    shares = covered_after(surface_of(mesh, session, mesh_scale), cameras, camera)
    counts = sorted({*range(STEP, len(shares), STEP), len(shares)})
    lines = [f"{count:4d} views: {100 * shares[count - 1]:5.1f} % covered" for count in counts]
    found = {"path": str(path), "mesh": str(mesh), "views": len(shares), "covered": shares[-1], "covered_after": shares}
    console.report(found, as_json=as_json, text="\n".join(lines))


def _recorded(path: Path, calibration: "Calibration | None") -> "tuple[Trajectory, NDArray[np.float64], Camera | None]":
    """The trajectory of a recording, (m, 4, 4) base_from_camera of its training views, and the camera where it is known."""
    import numpy as np

    from koala3d.capture.model.rig import recorded_carrier
    from koala3d.capture.model.trajectory import recorded_trajectory
    from koala3d.capture.sessions.adaptive.session import check
    from koala3d.capture.sessions.adaptive.shape import eye_of
    from koala3d.datasets.build import camera_for
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.recording import Recording

    recording = Recording.open(path)
    session = recorded_trajectory(recording)
    check(session)
    frames = sorted((one for one in recording.frames if one.split == "train"), key=lambda one: one.host_time_ns)
    if not frames:
        raise UsageError("has no training views", where=path, remedy="continue it with --resume")
    eye = eye_of(recorded_carrier(recording).flange_from_camera, calibration)
    cameras = np.stack([eye(frame.base_from_flange, frame.joints) for frame in frames])
    return session, cameras, None if calibration is None else camera_for(recording, calibration)[0]


def _planned(
    session: "Trajectory", mount: "Carrier", calibration: "Calibration | None"
) -> "tuple[NDArray[np.float64], Camera | None]":
    """(m, 4, 4) base_from_camera of the planned training views of a trajectory, and the camera where it is known."""
    import numpy as np

    from koala3d.capture.planning import plan
    from koala3d.capture.sessions.adaptive.session import check
    from koala3d.capture.sessions.adaptive.shape import eye_of, lens_of

    check(session)
    eye = eye_of(mount.flange_from_camera, calibration)
    planned = [view for view in plan(session, mount) if view.viewpoint.split == "train"]
    cameras = np.stack([eye(mount.arm.forward(view.joints), view.joints) for view in planned])
    return cameras, lens_of(session, calibration)
