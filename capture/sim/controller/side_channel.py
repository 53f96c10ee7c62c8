"""The simulation's own port: reports where the arm truly is, and triggers faults of the controller.

One JSON object per line, {"do": "drop"}; one reply per line. No real controller has it, so no driver may use it.
"""

import asyncio
import json
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from koala3d.capture.drivers.ur.modes import RobotMode, SafetyMode
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.kinematics import JOINT_LIMIT, pose_from_six
from koala3d.capture.sim.controller.installation import Installation
from koala3d.capture.sim.controller.motions.warmth import Warmth
from koala3d.capture.sim.controller.server import ControllerServer, closing
from koala3d.capture.sim.controller.state import Controller

DROP = "drop"  # cuts every RTDE connection


async def serve(server: ControllerServer, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Serve one connection."""
    with closing(writer):
        while line := await reader.readline():
            writer.write((json.dumps(reply(server, line)) + "\n").encode())
            await writer.drain()


def reply(server: ControllerServer, line: bytes) -> dict[str, Any]:
    """Answer to one request; {"error": ...} where it is invalid."""
    try:
        request = json.loads(line)
        if (do := request.pop("do")) == DROP:
            server.drop()
            return {"ok": True}
        return ACTIONS[do](server.controller, **request) or {"ok": True}
    except (ValueError, KeyError, TypeError) as error:
        return {"error": f"{type(error).__name__}: {error}; actions: {', '.join((*ACTIONS, DROP))}"}


def _truth(controller: Controller, exposure_s: float = 0.0, count: int = 0) -> dict[str, Any]:
    """Where the flange really is [m], now and in the middle of `count` equal parts of an exposure that begins now."""
    arm, now = controller.arm, controller.now
    joints, speeds = arm.actual(now)
    moments = now + (np.arange(count) + 0.5) / max(count, 1) * exposure_s
    return {
        "base_from_flange": arm.true_base_from_flange(now).tolist(),
        "exposed": [arm.true_base_from_flange(moment).tolist() for moment in moments],
        "joints": joints.tolist(),
        "speeds": speeds.tolist(),
        "moving": arm.moving(now),
        "robot_time_s": now,
        "motion_s": arm.profile.duration,
        "phase_s": arm.phase(now),
        "time_scale": controller.time_scale,
        "safety": arm.safety.name,
        "mode": arm.mode.name,
        "program_running": controller.program_running,
        "freedrive": controller.arm.freedrive or controller.arm.button,
    }


def _motions(controller: Controller, settle_spread: float = 5e-5) -> dict[str, Any]:
    """The latest motions: start on the controller's clock, duration, and until when after it joints vary by more [s, rad]."""
    arm = controller.arm
    return {"motions": [[start, profile.duration, arm.swings_for(profile, settle_spread)] for start, profile in arm.motions]}


def _program(controller: Controller) -> dict[str, Any]:
    """The text of the newest control program; empty: there was none."""
    return {"text": controller.program.text if controller.program is not None else ""}


def _silent(controller: Controller, seconds: float) -> None:
    """Send no data for some real time; the connections stay open, the dashboard answers."""
    controller.silent_until = time.monotonic() + seconds


def _hang(controller: Controller, seconds: float) -> None:
    """Accept connections but answer on no port for some real time; 0 ends it."""
    controller.hung_until = time.monotonic() + seconds


def _ignore_commands(controller: Controller, ignore: bool = True) -> None:
    """Stop acknowledging commands, or resume."""
    controller.deaf = ignore


def _refuse_stop(controller: Controller, refuse: bool = True, blind: bool = False) -> None:
    """Answer the dashboard's order to stop with a failure, or obey it again. `blind`: it knows nothing of uploaded programs."""
    controller.unstoppable, controller.blind = refuse, blind


def _install(controller: Controller, model: str = "", tcp: list[float] | None = None, **settings: Any) -> None:
    """Set what a person sets at the pendant, by the names of `Installation`; without arguments, as it was at the start.

    `model`: another arm stands there, with nominal links; `tcp`: (6,) position [m] and rotation vector [rad] of the tool.
    """
    unknown = settings.keys() - vars(Installation()).keys()
    if unknown:
        raise ValueError(f"no setting {', '.join(sorted(unknown))}")
    controller.installed = Installation(**{"up": controller.up, **settings})
    controller.installed.version = tuple(controller.installed.version)
    controller.arm.links = load_arm(model).links if model else controller.links
    controller.arm.flange_from_tcp = pose_from_six(tcp or np.zeros(6))
    controller.arm.payload = None


def _safety(controller: Controller, mode: str = "NORMAL", power: str = "RUNNING") -> None:
    """Put the controller into a safety mode and a robot mode, by name."""
    controller.arm.safety, controller.arm.mode, controller.guarded_until = SafetyMode[mode], RobotMode[power], math.inf


def _safeguard(controller: Controller, mode: str = "SAFEGUARD_STOP", seconds: float = math.inf) -> None:
    """Pause the program by a safeguard, which lets it go on by itself after some real time."""
    controller.arm.safety, controller.guarded_until = SafetyMode[mode], time.monotonic() + seconds


def _joint_limit(controller: Controller, joint: int = 1, lower_deg: float = -360.0, upper_deg: float = 360.0) -> None:
    """Narrow the range of a joint (1 to 6), as safety settings do; leaving it causes a protective stop."""
    controller.arm.joint_limits[:, joint - 1] = np.clip(np.radians([lower_deg, upper_deg]), -JOINT_LIMIT, JOINT_LIMIT)


def _reach(controller: Controller, metres: float = np.inf) -> None:
    """Refuse targets of the flange beyond this distance from the base: the program ends."""
    controller.arm.reach_m = metres


def _freedrive(controller: Controller, pressed: bool = True) -> None:
    """Press or release the pendant's freedrive button, which works only while no program runs."""
    if pressed and controller.program_running:
        raise ValueError("the button does nothing while a program runs: the program itself switches freedrive on")
    controller.arm.button = pressed


def _push(controller: Controller, joints: list[float]) -> None:
    """Move the arm by hand to joint angles [rad], which takes its time; the arm must be in freedrive."""
    goal = np.asarray(joints, np.float64)
    if goal.shape != (controller.arm.model.count,) or not np.isfinite(goal).all():
        raise ValueError(f"joints: {controller.arm.model.count} finite numbers")
    if not (controller.arm.freedrive or controller.arm.button):
        raise ValueError("the arm is not in freedrive and cannot be pushed")
    controller.arm.push(goal, controller.now)


def _signals(controller: Controller) -> dict[str, Any]:
    """The electrical outputs: bits as in `actual_digital_output_bits`, and amperes or volts."""
    return {"digital": controller.signals.digital, "analog": controller.signals.analog, "volts": controller.signals.volts}


def _noise(controller: Controller, noise_rad: float | None = None) -> None:
    """Change the noise of the encoders (standard deviation [rad]); without an argument, as it was at the start."""
    controller.arm.noise_rad = controller.noise_rad if noise_rad is None else noise_rad


def _speed_slider(controller: Controller, fraction: float) -> None:
    """Set the pendant's slider to a fraction of full speed, 0.01 to 1."""
    controller.arm.set_speed_slider(fraction, controller.now)


def _warm_up(controller: Controller, drift_mm: float, minutes: float) -> None:
    """Begin to warm up: the joints become warmer, and the flange moves in the base, by so much in the end."""
    controller.arm.warmth = Warmth.drawn(controller.arm.seed, 1e-3 * drift_mm, minutes, controller.now)


ACTIONS: dict[str, Callable[..., dict[str, Any] | None]] = {
    "truth": _truth,
    "motions": _motions,
    "program": _program,
    "protective_stop": lambda controller: controller.arm.stop_for_safety(SafetyMode.PROTECTIVE_STOP, controller.now),
    "emergency_stop": lambda controller: controller.arm.stop_for_safety(SafetyMode.ROBOT_EMERGENCY_STOP, controller.now),
    "stop_program": Controller.stop_program,
    "silent": _silent,
    "hang": _hang,
    "ignore_commands": _ignore_commands,
    "refuse_stop": _refuse_stop,
    "install": _install,
    "safety": _safety,
    "safeguard": _safeguard,
    "joint_limit": _joint_limit,
    "reach": _reach,
    "noise": _noise,
    "speed_slider": _speed_slider,
    "warm_up": _warm_up,
    "freedrive": _freedrive,
    "push": _push,
    "signals": _signals,
}
"""Requests by name; see the functions for the arguments."""
