"""Checks of the controller's safety: its mode, reduced mode, stops, slider, and the checksum of its settings."""

from koala3d.capture.doctor.lines import Line, compared, judged, ok, unknown, wrong
from koala3d.capture.doctor.report import ControllerReport
from koala3d.capture.drivers.ur.modes import RobotMode, SafetyMode, is_guarded, may_move, name_of
from koala3d.capture.model.rig import InstallationDescription


def check(answers: ControllerReport, stated: InstallationDescription) -> list[Line]:
    """The lines."""
    return [*_modes(answers), _checksum(answers, stated)]


def _modes(answers: ControllerReport) -> list[Line]:
    if answers.sample is None:
        names = "power", "safety mode", "safeguard stop", "reduced mode", "speed slider"
        return [unknown(name, "no samples", "enable RTDE at the pendant") for name in names]
    slider, safety = float(answers.sample["target_speed_fraction"]), name_of(SafetyMode, int(answers.sample["safety_mode"]))
    reduced = safety == SafetyMode.REDUCED.name
    return [
        _power(int(answers.sample["robot_mode"]), safety),
        *_stops(safety, _status(answers)),
        judged(
            "reduced mode",
            not reduced,
            "active: speeds are limited" if reduced else "off",
            "leave the plane or input that triggers it; motions are slower, deadlines longer",
            blocks=False,
        ),
        judged("speed slider", slider > 0.99, f"{100 * slider:.0f} %", "motions take longer; move it to 100 %", blocks=False),
    ]


def _status(answers: ControllerReport) -> str:
    """What dashboard or Robot API call the safety mode; empty without them."""
    if answers.api is not None:
        return answers.api.safety_mode
    return (answers.dashboard or {}).get("safetystatus", "").partition(":")[2].strip()


def _power(mode: int, safety: str) -> Line:
    found = "on" if mode == RobotMode.RUNNING else _words(name_of(RobotMode, mode))
    if mode != RobotMode.RUNNING and not may_move(safety):
        return unknown("power", f"{found} after a stop", "mend the safety mode first")
    return judged("power", mode == RobotMode.RUNNING, found, "switch on and release the brakes at the pendant")


def _stops(safety: str, status: str) -> list[Line]:
    """Lines of the mode and of safeguards. `status`: what the pendant says of the mode; empty where it does not."""
    names, remedy = ("safety mode", "safeguard stop"), "find the cause, then release it at the pendant"
    if is_guarded(safety):
        first = unknown(names[0], "a safeguard holds the arm", "mend that first")
        return [first, wrong(names[1], f"open: {_words(safety)}", "close the fence or reset the scanner")]
    if may_move(safety) and (may_move(status) or not status):
        return [ok(names[0], "normal"), ok(names[1], "closed")]
    found = _words(safety) if safety in SafetyMode.__members__ else f"number {safety}, which Koala does not know"
    found += f"; the pendant says {_words(status)}" if status and status != safety else ""
    return [wrong(names[0], found, remedy), unknown(names[1], "hidden by the safety mode", "mend that first")]


def _words(name: str) -> str:
    """A mode as a person says it."""
    return name.lower().replace("_", " ")


def _checksum(answers: ControllerReport, stated: InstallationDescription) -> Line:
    name = "safety checksum"
    if answers.primary is None or answers.primary.checksum is None:
        return unknown(name, "the controller does not send it", "compare it at the top of the pendant's screen")
    return compared(name, answers.primary.checksum, stated.safety_checksum, "robot.installation.safety_checksum")
