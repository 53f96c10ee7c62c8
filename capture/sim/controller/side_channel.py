"""The simulation's own port: asks where the arm truly is, and tells the controller to have a fault.

One JSON object a line, {"do": "drop"}; one reply a line. No real controller has it, so no driver may know of it.
"""

import asyncio
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from capture.kinematics import JOINT_LIMIT
from capture.sim.controller.arm import Safety
from capture.sim.controller.server import ControllerServer

Server = ControllerServer


async def serve(server: Server, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Serve one connection."""
    try:
        while line := await reader.readline():
            writer.write((json.dumps(reply(server, line)) + "\n").encode())
    except (ConnectionError, ValueError):
        return
    finally:
        writer.close()


def reply(server: Server, line: bytes) -> dict[str, Any]:
    """Answer to one request; {"error": ...} where it is none."""
    try:
        request = json.loads(line)
        return ACTIONS[request.pop("do")](server, **request) or {"ok": True}
    except (ValueError, KeyError, TypeError) as error:
        return {"error": f"{type(error).__name__}: {error}; actions: {', '.join(ACTIONS)}"}


def _truth(server: Server, exposure_s: float = 0.0, count: int = 0) -> dict[str, Any]:
    """Where the flange really is [m], now and at `count` moments in the middle of equal parts of an exposure from now on."""
    arm, now = server.arm, server.now
    joints, speeds = arm.actual(now)
    moments = now + (np.arange(count) + 0.5) / max(count, 1) * exposure_s
    return {
        "base_from_flange": arm.true_base_from_flange(now).tolist(),
        "exposed": [arm.true_base_from_flange(moment).tolist() for moment in moments],
        "joints": joints.tolist(), "speeds": speeds.tolist(), "moving": arm.moving(now), "robot_time_s": now,
        "motion_s": arm.profile.duration, "phase_s": arm.phase(now), "time_scale": server.time_scale,
        "safety": arm.safety.name, "mode": arm.mode.name, "program_running": server.program_running,
    }  # fmt: skip


def _motions(server: Server, settle_speed: float = 0.001) -> dict[str, Any]:
    """The latest motions: start in the controller's time, duration, and how long joints swing faster than that after it [s]."""
    arm = server.arm
    return {"motions": [[start, profile.duration, arm.swings_for(profile, settle_speed)] for start, profile in arm.motions]}


def _drop(server: Server) -> None:
    """Cut every RTDE connection."""
    for session in list(server.sessions):
        session.writer.transport.abort()


def _silent(server: Server, seconds: float) -> None:
    """Send no data for some time on the wall; the connections stay open, the dashboard answers."""
    server.silent_until = time.monotonic() + seconds


def _hang(server: Server, seconds: float) -> None:
    """Take connections but answer on no port for some time on the wall; 0 ends it."""
    server.hung_until = time.monotonic() + seconds


def _ignore_commands(server: Server, ignore: bool = True) -> None:
    """Never acknowledge a command, or do so again."""
    server.deaf = ignore


def _joint_limit(server: Server, joint: int = 1, lower_deg: float = -360.0, upper_deg: float = 360.0) -> None:
    """Give a joint (1 to 6) a narrower range, as the safety settings of a real arm may: leaving it is a protective stop."""
    server.arm.joint_limits[:, joint - 1] = np.clip(np.radians([lower_deg, upper_deg]), -JOINT_LIMIT, JOINT_LIMIT)


def _reach(server: Server, metres: float = np.inf) -> None:
    """Let the controller refuse targets of the flange beyond this distance from the base: its program ends there."""
    server.arm.reach_m = metres


def _speed_slider(server: Server, fraction: float) -> None:
    """Set the slider on the pendant to a share of full speed, 0.01 to 1."""
    server.arm.slide_speed(fraction, server.now)


ACTIONS: dict[str, Callable[..., dict[str, Any] | None]] = {
    "truth": _truth,
    "motions": _motions,
    "protective_stop": lambda server: server.arm.stop_for_safety(Safety.PROTECTIVE_STOP, server.now),
    "emergency_stop": lambda server: server.arm.stop_for_safety(Safety.ROBOT_EMERGENCY_STOP, server.now),
    "stop_program": ControllerServer.stop_program,
    "drop": _drop,
    "silent": _silent,
    "hang": _hang,
    "ignore_commands": _ignore_commands,
    "joint_limit": _joint_limit,
    "reach": _reach,
    "speed_slider": _speed_slider,
}
"""What may be asked, by name; see the functions for the arguments."""
