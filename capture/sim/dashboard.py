"""The dashboard server's conversation: one line in, one line out."""

from typing import Protocol

from capture.sim.arm import Arm, RobotMode, Safety

GREETING = "Connected: Universal Robots Dashboard Server"
SERIAL = "20235500001"
_SAFETY_STATUS = {
    Safety.NORMAL: "NORMAL",
    Safety.PROTECTIVE_STOP: "PROTECTIVE_STOP",
    Safety.ROBOT_EMERGENCY_STOP: "ROBOT_EMERGENCY_STOP",
}


class Controller(Protocol):
    """What the dashboard can do with the controller that it belongs to."""

    arm: Arm
    version: tuple[int, int, int, int]

    @property
    def program_running(self) -> bool:
        """Whether a program runs."""
        ...

    def stop_program(self) -> None:
        """End the program; the arm slows down."""


def reply(controller: Controller, line: str) -> str:
    """Answer to one command."""
    arm, word = controller.arm, line.strip().lower()
    running = controller.program_running
    answers = {
        "polyscopeversion": "URSoftware {}.{}.{}.{} (simulated)".format(*controller.version),
        "get serial number": SERIAL,
        "get robot model": "UR5",
        "is in remote control": "true",
        "running": f"Program running: {str(running).lower()}",
        "robotmode": f"Robotmode: {arm.mode.name}",
        "safetystatus": f"Safetystatus: {_SAFETY_STATUS[arm.safety]}",
        "safetymode": f"Safetymode: {_SAFETY_STATUS[arm.safety]}",
        "programstate": f"{'PLAYING' if running else 'STOPPED'} rtde_control.urp",
        "get loaded program": "Loaded program: /programs/rtde_control.urp",
    }
    if word in answers:
        return answers[word]
    if word in ("stop", "pause"):
        controller.stop_program()
        return "Stopped" if word == "stop" else "Pausing program"
    return _act(arm, word)


def _act(arm: Arm, word: str) -> str:
    if word == "unlock protective stop":
        if arm.safety is Safety.PROTECTIVE_STOP:
            arm.safety = Safety.NORMAL
        return "Protective stop releasing"
    if word == "power on":
        arm.safety, arm.mode = Safety.NORMAL, RobotMode.IDLE
        return "Powering on"
    if word == "power off":
        arm.mode = RobotMode.POWER_OFF
        return "Powering off"
    if word == "brake release":
        if arm.mode is RobotMode.IDLE:
            arm.mode = RobotMode.RUNNING
        return "Brake releasing"
    if word.startswith(("popup", "close")):
        return {"close popup": "closing popup", "close safety popup": "closing safety popup"}.get(word, "showing popup")
    if word == "play":
        return "Failed to execute: play"
    return f"could not understand: '{word}'"
