"""A calibration and the session that it was made from, for Rerun's viewer.

`view` counts the views. In each: the camera where the arm says it is, and where its picture says; the links of the arm, if the
session has joint angles; the picture with the corners that were found, and arrows to them from where they were predicted.
"""

from pathlib import Path

import numpy as np

from koala3d.calib.handeye import verify
from koala3d.calib.page import board_mesh
from koala3d.calib.page.evidence import CalibrationEvidence, Sighting
from koala3d.calib.page.summary import describe_calibration
from koala3d.datasets import pose
from koala3d.datasets.kinematics import link_frames
from koala3d.datasets.reports.rerun_file import RerunFile, rerun_file

LINKS = (170, 178, 190)  # sRGB


def write(evidence: CalibrationEvidence, out: Path) -> None:
    """Write what a calibration was made from as a new file `out`."""
    calibration, session = evidence.calibration, evidence.everything
    moving = "board" if session.eye_to_hand else "camera"
    with rerun_file(out, "calibration") as shown:
        shown.text("calibration", f"```\n{describe_calibration(calibration)}\n```")
        shown.frame("base", np.eye(4), always=True, axes_m=0.15)
        _board(shown, evidence)
        shown.camera("base/camera", calibration.camera)
        for name, matrix in (("camera", calibration.base_from_camera), ("board", calibration.base_from_board)):
            if matrix is not None:
                shown.frame(f"base/{name}", matrix.matrix, always=True, axes_m=0.05)
        for number, sighting in enumerate(evidence.sightings()):
            shown.at(view=number)
            shown.frame(f"base/{moving}", sighting.by_arm)
            shown.frame(f"base/{moving}_by_picture", sighting.by_picture, axes_m=0.04)
            if calibration.poses:
                shown.frame("base/flange", session.base_from_flange[number], axes_m=0.08)
            if session.joints is not None:
                shown.line("base/links", link_frames(session.joints[number], session.links)[:, :3, 3], LINKS)
            _picture(shown, sighting, evidence)


def _board(shown: RerunFile, evidence: CalibrationEvidence) -> None:
    """The target below the entity that stands for it."""
    for name, ((vertices, faces), grey) in board_mesh.parts(evidence.everything.board).items():
        colours = np.full((len(vertices), 3), grey, np.uint8)
        shown.mesh(f"base/board/{name}", vertices, faces, colours=colours, always=True)


def _picture(shown: RerunFile, sighting: Sighting, evidence: CalibrationEvidence) -> None:
    """A view's picture, its corners and its errors."""
    if sighting.image is not None:
        shown.picture("base/camera/picture", sighting.image, evidence.calibration.camera)
    residuals = sighting.residuals.get(evidence.kind)
    shown.corners("base/camera/corners", sighting.pixels, residuals, evidence.calibration.camera)
    shown.numbers("rms_px", {kind.replace(" ", "_"): verify.rms(values) for kind, values in sighting.residuals.items()})
    if evidence.corrections is not None:
        between = pose.inverse(sighting.by_arm) @ sighting.by_picture
        shown.numbers("arm_against_picture", {"mm": 1e3 * float(np.linalg.norm(between[:3, 3]))})
