"""A calibration as one HTML page that needs nothing else: numbers with their uncertainty, figures, views left out."""

from pathlib import Path

import numpy as np

from calib.calibrate import Solution
from calib.errors import CalibrationError
from calib.intrinsics import crossval, estimate
from calib.page import figures
from calib.page.summary import notes
from datasets import pose
from datasets.calibration import Calibration, UncertainPose
from datasets.reports.html import Number, ReportPage

POSES = ("flange_from_camera", "base_from_camera", "base_from_board", "flange_from_board")
CENTRE = {"fx": "px", "fy": "px", "cx": "px", "cy": "px"}
MEANINGS = {
    "rms_px": "root mean square of the residuals of the fit, which has seen these views",
    "held_out_px": "the same for views predicted from the others: what a reconstruction will meet",
    "held_out_mm": "the same at the target, across the line of sight",
    "arm_translation_mm": "what the arm's reports were corrected by, per axis",
    "arm_rotation_deg": "the same of rotation",
}
"""Of what is at the head of the page."""


def write(path: Path, calibration: Calibration, solution: Solution, *, made_by: str = "") -> None:
    """Write the page to `path`; `made_by` is the command. Raises UsageError where something is there already."""
    page(calibration, solution, made_by=made_by).write(path)


def page(calibration: Calibration, solution: Solution, *, made_by: str = "") -> ReportPage:
    """The page."""
    report = ReportPage("Calibration", made_by=[made_by] if made_by else [])
    residuals = calibration.residuals
    units = {name: "px" if name.endswith("_px") else "mm" if name.endswith("_mm") else "°" for name in MEANINGS}
    known = {name: Number(residuals[name], units[name]) for name in MEANINGS if residuals.get(name) is not None}
    shown = {
        "on unseen views": known.get("held_out_px"),
        "the same at the target": known.get("held_out_mm"),
        "residual": known["rms_px"],
    }
    report.headline([(name, value) for name, value in shown.items() if value is not None],
                    f"{residuals['views_used']} views, {residuals['corners']} corners in {residuals['coverage']:.0%} of the image")  # fmt: skip
    report.section("Result")
    for name in POSES:
        if (value := getattr(calibration, name)) is not None:
            _pose(report, name, value)
    _camera(report, calibration)
    report.heading("what the fit left")
    report.numbers((name.rsplit("_", 1)[0].replace("_", " "), value, MEANINGS[name]) for name, value in known.items())
    if found := notes(calibration):
        report.items(f"warning: {note}" for note in found)
    _left_out(report, solution)
    _figures(report, solution)
    for name in POSES:
        if (value := getattr(calibration, name)) is not None:
            report.section(f"Uncertainty of {name}")
            report.picture(figures.ellipses(name, value), f"Uncertainty of {name}")
    _cross_validation(report, calibration, solution)
    return report


def _pose(report: ReportPage, name: str, value: UncertainPose) -> None:
    """Position and rotation vector, each with its standard deviation per axis."""
    position, turn = 1e3 * value.matrix[:3, 3], np.rad2deg(pose.rotation_vector(value.matrix))
    report.heading(name)
    report.numbers([(axis, Number(float(p), "mm", float(s)), "position") for axis, p, s in
                    zip("xyz", position, value.translation_std_mm, strict=True)] +
                   [(f"turn about {axis}", Number(float(r), "°", float(s)), "rotation vector; deviation about the first frame's axis")
                    for axis, r, s in zip("xyz", turn, value.rotation_std_deg, strict=True)])  # fmt: skip


def _camera(report: ReportPage, calibration: Calibration) -> None:
    camera = calibration.camera
    report.heading(f"camera, {camera.width}×{camera.height} px")
    meanings = {"fx": "focal length", "fy": "focal length", "cx": "principal point", "cy": "principal point"}
    report.numbers((name, Number(getattr(camera, name), CENTRE.get(name, ""), std), meanings.get(name, "distortion"))
                   for name, std in calibration.camera_std.items())  # fmt: skip
    offsets = calibration.joint_offsets
    if offsets is not None:
        report.heading("joints stand further than the arm knows")
        found = list(zip(np.rad2deg(offsets.offsets), np.rad2deg(offsets.std), strict=True))
        report.numbers((f"joint {i}", Number(float(found[i - 1][0]), "°", float(found[i - 1][1])), "") for i in range(2, 6))


def _figures(report: ReportPage, solution: Solution) -> None:
    drawn = (
        ("Residuals over the image", "Arrows that point the same way in one region mean a lens that the model does not follow.",
         figures.residual_vectors),
        ("Views", "A view that stands out was blurred, taken in motion, or is in truth two.", figures.view_errors),
        ("Coverage", "Distortion is known where corners were seen; the centre of the image from tilts on all sides.", figures.coverage),
        ("Rotations", "Turns about at least two axes are needed; the further the points reach on all sides, the better.",
         figures.rotations),
    )  # fmt: skip
    for title, words, draw in drawn:
        report.section(title, words)
        report.picture(draw(solution), title)


def _left_out(report: ReportPage, solution: Solution) -> None:
    report.section("Views left out")
    rows = [(name, "no target was found") for name in solution.first.session.unseen] + list(solution.left_out.items())
    if rows:
        report.table(("view", "why"), rows)
    else:
        report.paragraph("None.")


def _cross_validation(report: ReportPage, calibration: Calibration, solution: Solution) -> None:
    """The map of differences between two halves of the views; a sentence where a half is not enough."""
    title = "Two halves of the views"
    report.section(title, "Where cameras from two halves of the views disagree, the calibration is not to be trusted.")
    if not calibration.camera_std:
        return report.paragraph("The camera was given; nothing of it was estimated.")
    free = tuple(name for name in calibration.camera_std if name not in CENTRE)
    session = solution.fit.session
    boards = estimate.camera_from_boards(calibration.camera, session.observations)
    lens = estimate.Lens(free, calibration.camera.fisheye)
    try:
        difference = crossval.cross_validate(calibration.camera, lens, session.observations, boards)
    except CalibrationError as error:
        return report.paragraph(str(error))
    report.picture(figures.difference_map(difference, solution), title)
