"""A calibration as text for a terminal."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from koala3d.calib.handeye import credible, links, surface
from koala3d.calib.handeye.uncertainty import MAX_STD_M
from koala3d.calib.handeye.verify import Verification
from koala3d.calib.intrinsics import projection, splined
from koala3d.calib.page import driver_camera
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose

RELAXED = " (bound relaxed)"
"""Mark of poses that would have been refused, or might have been, without `--allow-mm`."""
REPEATS_MM = 0.1
"""Errors of the links from which on the summary mentions that the arm's errors repeat."""
_DIGITS = {"fx": 2, "fy": 2, "cx": 2, "cy": 2}


def describe_calibration(calibration: Calibration) -> str:
    """Several lines: poses with standard deviations, intrinsics, residuals, notes."""
    lines = []
    mark = RELAXED if calibration.residuals.allowed_mm else ""
    for title, value in calibration.poses.items():
        lines += _pose_lines(f"{title}{mark}", value)
    if "folder" in calibration.provenance:
        lines.append("flange              is the frame whose poses were imported: often the tool centre point (TCP)")
    camera, residuals = calibration.camera, calibration.residuals
    if calibration.link_errors is not None:
        lines += [f"{kind:<19} {values}" for kind, values in links.in_words(calibration.link_errors)]
    if shape := surface.in_words(residuals):
        lines.append(f"target              {shape}")
    lines.append(f"camera              {camera.width}x{camera.height}")
    for name, std in calibration.camera_std.items():
        if projection.is_knot(name):
            continue
        digits = _DIGITS.get(name, 5)
        unit = " px" if name in _DIGITS else ""
        lines.append(f"  {name:<17} {getattr(camera, name):.{digits}f} ± {std:.{digits}f}{unit}")
    if knots := splined.in_words(camera):
        lines.append(f"  {'spline':<17} {knots}")
    lines += _board_lines(residuals.boards or ())
    lines.append(f"residual            {residuals.rms_px:.3f} px rms over {residuals.corners} corners")
    if residuals.held_out_px is not None:
        millimetres = f" = {residuals.held_out_mm:.3f} mm at the target" if residuals.held_out_mm is not None else ""
        lines.append(f"on unseen views     {residuals.held_out_px:.3f} px{millimetres}")
    if residuals.corners_left_out and residuals.held_out_all_px is not None:
        every = f"{residuals.held_out_all_px:.3f} px = {residuals.held_out_all_mm:.3f} mm"
        lines.append(f"  with every corner {every}, the {residuals.corners_left_out} that were left out included")
    if residuals.arm_translation_mm is not None:
        millimetres, degrees = residuals.arm_translation_mm, residuals.arm_rotation_deg
        lines.append(f"arm errors          {millimetres:.3f} mm, {degrees:.4f} deg per axis")
    if (residuals.arm_links_mm or 0.0) > REPEATS_MM:
        stop = f"{residuals.arm_stop_mm:.3f} mm, {residuals.arm_stop_deg:.4f} deg"
        of_links = f"{residuals.arm_links_mm:.2f} mm, {residuals.arm_links_deg:.3f} deg"
        lines.append(f"  of these          {stop} at each stop; the rest repeats, like links that are off by {of_links}")
    if residuals.latency_s is not None and residuals.latency_std_s is not None:
        late = (
            f"{1e3 * residuals.latency_s:.2f} ± {1e3 * residuals.latency_std_s:.2f} ms by {residuals.latency_pictures} pictures"
        )
        lines.append(f"latency             {late} of a moving arm: stamps are so much later than exposures by the poses' clock")
        lines.append(
            f"  there             the target moves by {residuals.latency_px_per_ms:.2f} px each ms, which blurs it so much too"
        )
    lines.append(f"views used          {residuals.views_used}, corners in {residuals.coverage:.0%} of the image")
    lines += [f"note: {note}" for note in notes(calibration)]
    return "\n".join(lines)


def _board_lines(boards: Sequence[dict[str, Any]]) -> list[str]:
    """A line for each of several targets."""
    lines = []
    for board in boards:
        (value,) = (UncertainPose.from_json(board[key], where=key) for key in board if key.endswith("_from_board"))
        millimetres, degrees = value.total_std
        error = "no corner fits" if board["rms_px"] is None else f"{board['rms_px']:.3f} px"
        counts = f"{board['views']} views, {board['corners']} corners, {error}"
        lines.append(f"target              {board['name']}: {counts}; placed to {millimetres:.3f} mm, {degrees:.4f} deg")
    return lines


def notes(calibration: Calibration) -> list[str]:
    """What a user should know before using the calibration, one sentence each."""
    residuals, found = calibration.residuals, []
    if allowed := residuals.allowed_mm:
        worst = max(float(value.translation_std_mm.max()) for value in calibration.poses.values())
        usual = 1e3 * MAX_STD_M
        state = f"{worst:.2g} mm is above it" if worst > usual else "it would have been kept"
        found.append(f"the bound on uncertain poses was relaxed from {usual:g} to {allowed:g} mm by --allow-mm; {state}")
    if seems := residuals.target_seems:
        stretch, sag = 100 * np.abs(seems[:2]).max(), 1e3 * np.abs(seems[2:]).max()
        seen = f"the corners fit a target that is stretched by {stretch:.2g} % and bent by {sag:.2g} mm"
        found.append(f"{seen}; --print-percent 0.5 --sag-mm 2 estimates that")
    if residuals.views_unseen:
        found.append(f"no target was found in view {', '.join(residuals.views_unseen)}")
    reasons = residuals.why_left_out
    for name in residuals.views_left_out:
        found.append(f"view {name} is left out: {reasons.get(name, 'arm and picture disagree')}")
    if residuals.settled is False:
        found.append("the refinement did not converge; look for views that do not fit")
    if residuals.coverage is not None and residuals.coverage < 0.4:
        found.append("corners cover little of the image; distortion is not known elsewhere")
    if residuals.links_not_shown:
        found.append(f"the views do not determine {', '.join(residuals.links_not_shown)}")
    without = residuals.held_out_px_without_link_errors
    if without is not None and residuals.held_out_px is not None and not residuals.held_out_px < 0.98 * without:
        found.append(
            f"errors of the links do not help on unseen views ({without:.3f} px without them): omit --joint-deg and --link-mm"
        )
    if (share := credible.share_left_out(residuals)) > credible.LARGE_SHARE:
        found.append(f"{share:.0%} of the corners are left out; check poses, target and sharpness of the views that lost most")
    if residuals.arm_translation_mm is not None and residuals.held_out_px is None:
        found.append("there is no error on unseen views: without a fifth of the views the rest could not be fitted")
    bag = calibration.provenance.get("bag")
    if isinstance(bag, dict):
        found += map(str, bag.get("notes") or ())
        if "camera_info" in bag:  # files of the first version of bags lack it
            found.append(driver_camera.in_words(calibration.camera, bag["camera_info"]))
        if residuals.latency_s is None:
            found.append("latency of the pictures is not known: too few show the target while the arm moves")
    return [*found, *_arm_notes(calibration)]


def _arm_notes(calibration: Calibration) -> list[str]:
    """A sentence for positions and one for rotations of the arm that are worse than stated."""
    residuals, stated, found = calibration.residuals, calibration.provenance.get("arm_accuracy_stated", {}), []
    errors = (
        ("positions", "translation_mm", residuals.arm_translation_mm),
        ("rotations", "rotation_deg", residuals.arm_rotation_deg),
    )
    for what, key, error in errors:
        if stated.get(key) and error is not None and (times := error / stated[key]) > 3:
            advice = "check settling, time stamps and the arm's own calibration"
            accuracy = f"{stated[key]:g} {key.rpartition('_')[2]}"
            found.append(f"the arm's {what} are {times:.0f} times less accurate than stated ({accuracy}): {advice}")
    return found


def describe_verification(verification: Verification) -> str:
    """Two lines: the error, and the worst view."""
    worst = max(verification.view_rms_px, key=lambda name: verification.view_rms_px[name])
    v = verification
    return (
        f"predicted corners   {v.rms_px:.3f} px = {v.rms_mm:.3f} mm rms over {v.corners} corners in {len(v.view_rms_px)} views\n"
        f"worst view          {worst}: {v.view_rms_px[worst]:.3f} px"
    )


def _pose_lines(title: str, value: UncertainPose) -> list[str]:
    position = 1e3 * value.matrix[:3, 3]
    rotation = np.rad2deg(pose.rotation_vector(value.matrix))
    translations = ", ".join(f"{p:.3f} ± {s:.3f}" for p, s in zip(position, value.translation_std_mm, strict=True))
    deviations = ", ".join(f"± {s:.4f}" for s in value.rotation_std_deg)
    return [
        title,
        f"  translation       {translations} mm",
        f"  rotation vector   {', '.join(f'{r:.4f}' for r in rotation)} deg",
        f"  uncertain by      {deviations} deg about the first frame's x, y, z",
    ]
