"""Checks of a camera with pictures: whether its driver keeps the contract of all drivers."""

from koala3d.capture.doctor.lines import Line, ok, wrong
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.rig.cameras import camera_for
from koala3d.capture.rig.contract import CONTRACT, Subject, check
from koala3d.capture.rig.naming import describe, is_simulated


def check_driver(rig: str, session: Trajectory) -> list[Line]:
    """A line for each clause of the contract. Pictures are taken with the settings of a trajectory; the arm is not used."""
    description = describe(rig)
    scene = "grey_card" if is_simulated(rig, description) else ""
    subject = Subject(
        lambda wanted: camera_for(rig, session.model_copy(update={"camera": wanted}), scene=scene),
        session.camera,
        other_exposure_us=None if "exposure_us" in description.camera.leave else session.camera.exposure_us / 2,
    )
    broken = check(subject)
    remedy = "report it with the model of the camera and this table"
    return [
        wrong(name.replace("_", " "), broken[name], remedy) if name in broken else ok(name.replace("_", " "), "kept")
        for name in CONTRACT
    ]
