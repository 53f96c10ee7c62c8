"""Checks of the controller's safety: its mode, reduced mode, stops, slider, and the checksum of its settings."""

from koala3d.capture.doctor.lines import Line, compared, judged, ok, unknown, wrong
from koala3d.capture.doctor.report import ControllerReport
from koala3d.capture.model.rig import InstallationDescription

NORMAL, REDUCED, PROTECTIVE, RECOVERY, SAFEGUARD, SYSTEM_STOP, ROBOT_STOP, VIOLATION, FAULT = range(1, 10)
STOPS = {
    PROTECTIVE: "protective stop",
    RECOVERY: "recovery mode",
    SYSTEM_STOP: "system emergency stop",
    ROBOT_STOP: "robot emergency stop",
    VIOLATION: "safety violation",
    FAULT: "safety fault",
}
RUNNING = 7
MODES = {
    0: "disconnected",
    1: "confirming safety",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "idle, brakes on",
    6: "backdrive",
}


def check(answers: ControllerReport, stated: InstallationDescription) -> list[Line]:
    """The lines."""
    return [*_modes(answers), _checksum(answers, stated)]


def _modes(answers: ControllerReport) -> list[Line]:
    names = "power", "safety mode", "safeguard stop", "reduced mode", "speed slider"
    if answers.sample is None:
        return [unknown(name, "no samples", "enable RTDE at the pendant") for name in names]
    safety, mode = int(answers.sample["safety_mode"]), int(answers.sample["robot_mode"])
    slider = float(answers.sample["target_speed_fraction"])
    power = MODES.get(mode, f"robot mode {mode}")
    if safety in STOPS and mode != RUNNING:
        first = unknown(names[0], f"{power} after a stop", "mend the safety mode first")
    else:
        first = judged(
            names[0], mode == RUNNING, "on" if mode == RUNNING else power, "switch on and release the brakes at the pendant"
        )
    stopped = STOPS.get(safety)
    remedy = "find the cause, then release it at the pendant"
    return [
        first,
        wrong(names[1], stopped, remedy) if stopped else ok(names[1], "normal"),
        judged(
            names[2], safety != SAFEGUARD, "open" if safety == SAFEGUARD else "closed", "close the fence or reset the scanner"
        ),
        judged(
            names[3],
            safety != REDUCED,
            "active: speeds are limited" if safety == REDUCED else "off",
            "leave the plane or input that triggers it; motions are slower, deadlines longer",
            blocks=False,
        ),
        judged(names[4], slider > 0.99, f"{100 * slider:.0f} %", "motions take longer; move it to 100 %", blocks=False),
    ]


def _checksum(answers: ControllerReport, stated: InstallationDescription) -> Line:
    name = "safety checksum"
    if answers.primary is None or answers.primary.checksum is None:
        return unknown(name, "the controller does not send it", "compare it at the top of the pendant's screen")
    return compared(name, answers.primary.checksum, stated.safety_checksum, "robot.installation.safety_checksum")
