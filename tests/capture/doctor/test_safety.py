"""Every number that a controller may report as its safety mode."""

import pytest

from koala3d.capture.doctor.lines import Verdict
from koala3d.capture.doctor.report import ControllerReport
from koala3d.capture.doctor.safety import check
from koala3d.capture.drivers.ur.modes import SafetyMode
from koala3d.capture.model.rig import InstallationDescription

SAFEGUARDS = {5: "safeguard stop", 12: "automatic mode", 13: "three position", 14: "three position", 16: "immi"}
SAFEGUARDS |= {18: "profisafe automatic", 19: "profisafe", 22: "safety api"}
"""Universal Robots, "Real-Time Data Exchange guide" and client library: those that a fence or an enabling switch causes."""


def lines_of(number: int, status: str | None = None) -> dict[str, tuple[Verdict, str]]:
    sample = {"safety_mode": number, "robot_mode": 7, "target_speed_fraction": 1.0}
    dashboard = None if status is None else {"safetystatus": f"Safetystatus: {status}"}
    found = check(ControllerReport("here", dashboard, None, sample), InstallationDescription())
    return {line.name: (line.verdict, line.found) for line in found}


@pytest.mark.parametrize("number", range(-1, 40))
def test_only_normal_and_reduced_mode_are_in_order(number: int) -> None:
    found = lines_of(number)
    wrong = [name for name, (verdict, _) in found.items() if verdict is Verdict.WRONG]
    if number == 1:
        assert wrong == [] and found["safety mode"] == (Verdict.OK, "normal")
    elif number == 2:
        assert wrong == ["reduced mode"]
    elif number in SAFEGUARDS:
        assert wrong == ["safeguard stop"] and SAFEGUARDS[number] in found["safeguard stop"][1]
    else:
        assert wrong == ["safety mode"] and found["safeguard stop"][0] is Verdict.UNKNOWN
    unknown = f"number {number}, which Koala does not know"
    assert (found["safety mode"][1] == unknown) == (number < 1 or number == 21 or number > 22)


def test_the_pendant_is_heard_too() -> None:
    assert lines_of(1, "NORMAL") | {"safety checksum": ()} == lines_of(1) | {"safety checksum": ()}
    assert lines_of(1, "FAULT")["safety mode"] == (Verdict.WRONG, "normal; the pendant says fault")
    assert lines_of(33, "NEW_STOP")["safety mode"][1].endswith("does not know; the pendant says new stop")


def test_a_mode_is_a_stop_unless_the_arm_may_move() -> None:
    assert [mode for mode in SafetyMode if lines_of(mode)["safety mode"][0] is Verdict.OK] == [1, 2]
