"""Checks of the arm itself: which it is, and how it is mounted."""

import numpy as np

from koala3d.capture.doctor.lines import Line, compared, judged, ok, unknown, wrong
from koala3d.capture.doctor.report import ControllerReport
from koala3d.capture.model.arm import identify, load_arm
from koala3d.capture.model.rig import RobotDescription
from koala3d.datasets import pose
from koala3d.datasets.kinematics import forward

OLDEST, POLYSCOPE_X = (5, 6), 10
OWN_M = 1e-3
"""The controller's own kinematics put the flange where it reports it; noise of the encoders makes 5 um of that [m]."""
STANDARD_GRAVITY, GRAVITY_WITHIN = 9.81, 0.5  # [m/s^2]; tool accelerometers are off by percents
LEVEL_DEG = 5.0  # a base that is tilted by more was mounted so on purpose, or its mounting was entered wrongly


def check(answers: ControllerReport, robot: RobotDescription, up: int | None) -> list[Line]:
    """The lines; `up` is the sign of the base's z axis in the upward direction that the session needs, None: the rig file's."""
    wanted = robot.installation.upwards if up is None else up
    return [_model(answers, robot), _kinematics(answers), *_identity(answers, robot), _mounting(answers, wanted)]


def _model(answers: ControllerReport, robot: RobotDescription) -> Line:
    name = "arm model"
    base_from_flange = answers.base_from_flange
    if answers.sample is None or base_from_flange is None:
        return unknown(name, "the controller does not say where its flange is", "enable RTDE and Primary at the pendant")
    found = identify(answers.sample["actual_q"], base_from_flange)
    words = f"{found.model.name}, flange {1e3 * found.distance_m:.1f} mm from where its nominal links put it"
    if not found.certain:
        return wrong(name, f"none that is known: nearest {words}", "write a file for this arm, or check the tool offset")
    remedy = f"the rig file has robot.model: {robot.model}; plans and collision checks would be those of another arm"
    return judged(name, found.may_be(load_arm(robot.model)), words, remedy)


def _kinematics(answers: ControllerReport) -> Line:
    name = "own kinematics"
    base_from_flange, links = answers.base_from_flange, answers.primary and answers.primary.links
    if answers.sample is None or base_from_flange is None or links is None:
        return unknown(name, "the controller does not give its calibrated links", "enable Primary/Secondary at the pendant")
    distance, angle = pose.difference(forward(answers.sample["actual_q"], links), base_from_flange)
    found = f"calibrated links agree with the reported pose to {1e3 * distance:.2f} mm"
    return judged(name, bool(distance < OWN_M and angle < OWN_M), found, "restart the controller; its calibration is not in use")


def _identity(answers: ControllerReport, robot: RobotDescription) -> list[Line]:
    version = answers.primary.version if answers.primary is not None else None
    lines = []
    if answers.dashboard is not None:
        serial = answers.dashboard["get serial number"]
        lines.append(compared("arm serial", serial, robot.installation.serial, "robot.installation.serial"))
        words = "".join(letter if letter.isdigit() or letter == "." else " " for letter in answers.dashboard["PolyscopeVersion"])
        numbers = (words.split() or [""])[0].split(".")
        version = version or tuple(int(part or 0) for part in (*numbers, "0", "0")[:3])  # type: ignore[assignment]
    else:
        lines.append(unknown("arm serial", "only the dashboard says it", "read it at the pendant"))
    if version is None:
        return [*lines, unknown("software", "no version was sent", "enable Primary/Secondary or Dashboard at the pendant")]
    text = ".".join(map(str, version))
    return [*lines, judged("software", version[:2] >= OLDEST, text, "update the controller to PolyScope 5.6 or newer")]


def _mounting(answers: ControllerReport, wanted: int) -> Line:
    name, base_from_flange = "mounting", answers.base_from_flange
    if answers.sample is None or base_from_flange is None:
        return unknown(name, "no accelerometer", "compare the mounting at the pendant with the arm")
    felt = base_from_flange[:3, :3] @ np.array(answers.sample["actual_tool_accelerometer"])
    size = float(np.linalg.norm(felt))
    if abs(size - STANDARD_GRAVITY) > GRAVITY_WITHIN:
        return unknown(name, f"the tool accelerometer measures {size:.1f} m/s^2", "let the arm rest, then ask again")
    tilt = float(np.degrees(np.arccos(np.clip(wanted * felt[2] / size, -1, 1))))
    up = "up" if wanted > 0 else "down"
    found = f"the base's z axis is {tilt:.0f} degrees from where the rig needs it, {up}"
    if tilt <= LEVEL_DEG:
        return ok(name, found)
    return wrong(name, found, "set the mounting at the pendant and 'up' in the trajectory to how the arm hangs or stands")
