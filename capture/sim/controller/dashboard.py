"""The dashboard server's protocol: one line in, one line out."""

from koala3d.capture.drivers.ur.modes import RobotMode, SafetyMode
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.state import Controller

GREETING = "Connected: Universal Robots Dashboard Server"


def reply(controller: Controller, line: str) -> str:
    """Answer to one command."""
    arm, word = controller.arm, line.strip().lower()
    running = controller.program_running
    state = "PLAYING" if running else "PAUSED" if controller.program_paused else "STOPPED"
    installed, loaded = controller.installed, "palletizing.urp" if controller.installed.program else "rtde_control.urp"
    answers = {
        "polyscopeversion": "URSoftware {}.{}.{}.{} (simulated)".format(*installed.version),
        "get serial number": installed.serial,
        "get robot model": arm.model.name.removesuffix("e"),
        "is in remote control": str(installed.remote).lower(),
        "running": f"Program running: {str(running).lower()}",
        "robotmode": f"Robotmode: {arm.mode.name}",
        "safetystatus": f"Safetystatus: {arm.safety.name}",
        "safetymode": f"Safetymode: {arm.safety.name}",
        "programstate": f"{state} {loaded}",
        "get loaded program": f"Loaded program: /programs/{loaded}",
    }
    if word in answers:
        return answers[word]
    if word == "stop":
        if controller.unstoppable or not (running or controller.program_paused):
            return "Failed to execute: stop"
        controller.stop_program()
        return "Stopped"
    if word == "pause":
        return "Pausing program" if controller.pause_program() else "Failed to execute: pause"
    if word == "play":  # programs are uploaded: none is loaded that could be started again
        return "Starting program" if controller.play_program() else "Failed to execute: play"
    return _act(arm, word)


def _act(arm: SimulatedArm, word: str) -> str:
    if word == "unlock protective stop":
        if arm.safety is SafetyMode.PROTECTIVE_STOP:
            arm.safety = SafetyMode.NORMAL
        return "Protective stop releasing"
    if word == "power on":
        arm.safety, arm.mode = SafetyMode.NORMAL, RobotMode.IDLE
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
    return f"could not understand: '{word[:100]}'"
