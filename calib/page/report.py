"""A stored calibration as one HTML page that needs nothing else: numbers with their uncertainty, figures, views left out."""

from collections.abc import Iterator, Mapping

import numpy as np

from koala3d.calib.errors import CalibrationError
from koala3d.calib.intrinsics import crossval, estimate, lenses, projection, splined
from koala3d.calib.intrinsics.over_image import Map
from koala3d.calib.page import figures, maps
from koala3d.calib.page.evidence import CalibrationEvidence
from koala3d.calib.page.summary import RELAXED, notes
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, LinkErrors, UncertainPose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.reports.html import Number, ReportPage

CENTRE = {"fx": "focal length", "fy": "focal length", "cx": "principal point", "cy": "principal point"}
MEANINGS = {
    "rms_px": "root mean square of the residuals of the views that the calibration was made from",
    "held_out_px": "the same for views predicted from the others: the error to expect in a reconstruction",
    "held_out_mm": "the same at the target, across the line of sight",
    "held_out_all_px": "on unseen views, corners included that the fit left out",
    "held_out_all_mm": "the same at the target",
    "arm_translation_mm": "estimated error of the arm's reports, per axis",
    "arm_rotation_deg": "the same for rotation",
}
"""Of the numbers at the head of the page."""


def page(
    evidence: CalibrationEvidence, *, made_by: str = "", distance_m: float = 0.5, others: Mapping[str, Map] | None = None
) -> ReportPage:
    """The page.

    Args:
        evidence: the calibration and its recording.
        made_by: the command.
        distance_m: of the points whose certainty is shown from the camera.
        others: how far other calibrations' cameras differ over the image, by their names.
    """
    calibration, residuals = evidence.calibration, evidence.calibration.residuals
    report = ReportPage("Calibration", made_by=[made_by] if made_by else [])
    units = {name: "px" if name.endswith("_px") else "mm" if name.endswith("_mm") else "°" for name in MEANINGS}
    values = {name: getattr(residuals, name) for name in MEANINGS}
    known = {name: Number(value, units[name]) for name, value in values.items() if value is not None}
    headings = {"held_out_px": "on unseen views", "held_out_mm": "the same at the target", "rms_px": "residual"}
    views = f"{residuals.views_used} views, {residuals.corners} corners in {residuals.coverage:.0%} of the image"
    report.headline([(words, known[name]) for name, words in headings.items() if name in known], views)
    report.section("Result")
    for name, value in calibration.poses.items():
        _pose(report, name + (RELAXED if residuals.allowed_mm else ""), value)
    _camera(report, calibration)
    report.heading("residuals")
    report.numbers((name.rsplit("_", 1)[0].replace("_", " "), value, MEANINGS[name]) for name, value in known.items())
    if found := [*notes(calibration), *evidence.notes]:
        report.items(f"warning: {note}" for note in found)
    report.section("Views left out")
    if evidence.left_out:
        report.table(("view", "why"), list(evidence.left_out.items()))
    else:
        report.paragraph("None.")
    _figures(report, evidence)
    for name, value in calibration.poses.items():
        report.section(f"Uncertainty of {name}")
        report.picture(figures.ellipses(name, value), f"Uncertainty of {name}")
    _certainty(report, calibration, distance_m)
    _cross_validation(report, evidence)
    for name, found in (others or {}).items():
        title = f"Difference from {name}"
        report.section(title, "The rotation that brings both cameras closest is left out: it looks like another principal point.")
        words = f"{name} differs by {found.rms_px:.3f} px rms"
        report.picture(figures.map_over_image(calibration.camera, words, found, "difference [px]"), title)
    return report


def _certainty(report: ReportPage, calibration: Calibration, distance_m: float) -> None:
    """The map of how certain it is where a point is seen; a sentence where the file does not say."""
    title = "Certainty over the image"
    report.section(title, "Trust the calibration where the deviation is small: no target was seen where it is large.")
    try:
        found = maps.projection_uncertainty(calibration, distance_m)
    except UsageError as error:
        return report.paragraph(str(error))
    of_rig = (calibration.flange_from_camera or calibration.base_from_camera) is not None
    what = f"points at {distance_m:g} m" if of_rig else "directions, up to a rotation of the camera"
    words = f"standard deviation of {what}: {found.rms_px:.3f} px rms"
    report.picture(figures.map_over_image(calibration.camera, words, found, "standard deviation [px]"), title)


def _pose(report: ReportPage, name: str, value: UncertainPose) -> None:
    """Position and rotation vector, each with its standard deviation per axis."""
    position, turn = 1e3 * value.matrix[:3, 3], np.rad2deg(pose.rotation_vector(value.matrix))
    meaning = "rotation vector; standard deviation about the first frame's axis"
    positions = zip("xyz", position, value.translation_std_mm, strict=True)
    turns = zip("xyz", turn, value.rotation_std_deg, strict=True)
    rows = [(axis, Number(float(p), "mm", float(std)), "position") for axis, p, std in positions]
    rows += [(f"rotation about {axis}", Number(float(r), "°", float(std)), meaning) for axis, r, std in turns]
    report.heading(name)
    report.numbers(rows)


def _camera(report: ReportPage, calibration: Calibration) -> None:
    camera = calibration.camera
    report.heading(f"camera, {camera.width}×{camera.height} px")
    report.numbers(
        (name, Number(getattr(camera, name), "px" if name in CENTRE else "", std), CENTRE.get(name, "distortion"))
        for name, std in calibration.camera_std.items()
        if not projection.is_knot(name)
    )
    if knots := splined.in_words(camera):
        report.paragraph(f"Splined lens: {knots}.")
    if calibration.link_errors is not None:
        report.heading("errors of the arm's links: true minus nominal")
        report.numbers(_link_rows(calibration.link_errors))


def _link_rows(found: LinkErrors) -> Iterator[tuple[str, Number, str]]:
    """A row for each error that was estimated."""
    units = np.repeat(["mm", "°"], 2 * found.links.count)
    scales = np.where(units == "mm", 1e3, np.rad2deg(1.0))
    for name, error, std, unit in zip(found.links.parameters, scales * found.errors, scales * found.std, units, strict=True):
        if std:
            yield name, Number(float(error), str(unit), float(std)), ""


def _figures(report: ReportPage, evidence: CalibrationEvidence) -> None:
    def add(title: str, words: str, png: bytes) -> None:
        report.section(title, words)
        report.picture(png, title)

    words = "Arrows that point the same way in one region show that the lens model does not fit there."
    add("Residuals over the image", words, figures.residual_vectors(evidence, evidence.kind))
    words = "A view that stands out was blurred, taken in motion, or mixes two exposures."
    add("Views", words, figures.view_errors(evidence))
    words = "Distortion is known where corners were seen; the principal point needs tilts in all directions."
    add("Coverage", words, figures.coverage(evidence))
    if evidence.corrections is not None:
        words = "Rotations about at least two axes are needed; the wider the points spread, the better."
        add("Rotations", words, figures.rotations(evidence))


def _cross_validation(report: ReportPage, evidence: CalibrationEvidence) -> None:
    """The map of differences between two halves of the views; a sentence where a half is not enough."""
    title, calibration = "Two halves of the views", evidence.calibration
    report.section(title, "Do not trust the calibration where cameras from two halves of the views disagree.")
    if not calibration.camera_std:
        return report.paragraph("The camera was given; nothing of it was estimated.")
    form = projection.form(calibration.camera)
    coefficients = tuple(name for name in calibration.camera_std if name not in CENTRE and not projection.is_knot(name))
    lens = lenses.Lens(coefficients, form.fisheye, form.grid)
    observations = evidence.session.observations
    boards = estimate.camera_from_boards(calibration.camera, observations)
    try:
        difference = crossval.cross_validate(calibration.camera, lens, observations, boards)
    except CalibrationError as error:
        return report.paragraph(str(error))
    report.picture(figures.difference_map(difference, evidence), title)
