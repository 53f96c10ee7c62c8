"""PolyScope X's Robot API on the simulated controller: which paths it has, by its version, and what they answer.

As Universal Robots' client library uses it. What safeguards are called is chosen here.
"""

import asyncio
import json
from collections.abc import Callable
from typing import Any

from koala3d.capture.drivers.ur.interfaces import robot_api as api
from koala3d.capture.sim.controller import dashboard
from koala3d.capture.sim.controller.state import Controller

Answer = tuple[int, dict[str, Any]]
LONGEST = 1 << 16  # bytes of a request
STATE = "/robotstate/v1/state"
REASONS = {200: "OK", 403: "Forbidden", 404: "Not Found", 409: "Conflict", 422: "Unprocessable Content"}
PROGRAM_ACTIONS = {"stop": "stop", "pause": "pause", "play": "play", "resume": "play"}
STATE_ACTIONS = {
    "POWER_ON": "power on",
    "POWER_OFF": "power off",
    "BRAKE_RELEASE": "brake release",
    "UNLOCK_PROTECTIVE_STOP": "unlock protective stop",
}
"""What the dashboard calls them."""


def _safety(controller: Controller) -> str:
    name = controller.arm.safety.name
    return "EMERGENCY_STOP" if name.endswith("EMERGENCY_STOP") else name


def _described(controller: Controller) -> dict[str, Any]:
    version = controller.installed.version
    number = "5.0.107" if version >= (10, 14) else "3.1.4" if version >= (10, 12) else "3.0.0"
    return {"openapi": "3.1.0", "info": {"title": "Robot API", "version": number}}


ANSWERS: dict[str, tuple[tuple[int, int], Callable[[Controller], dict[str, Any]]]] = {
    api.DESCRIPTION: ((10, 11), _described),
    api.PROGRAM: ((10, 11), lambda controller: {"state": dashboard.program_state(controller), "message": "ok"}),
    api.ROBOT_MODE: ((10, 12), lambda controller: {"mode": controller.arm.mode.name, "message": "ok"}),
    api.SAFETY_MODE: ((10, 12), lambda controller: {"mode": _safety(controller), "message": "ok"}),
    api.CONTROL_MODE: ((10, 12), lambda controller: {"mode": "REMOTE" if controller.installed.remote else "LOCAL"}),
    api.OPERATIONAL_MODE: ((10, 12), lambda controller: {"mode": controller.installed.operational_mode}),
    api.INFORMATION: (
        (10, 14),
        lambda controller: {"serialNumber": controller.installed.serial, "robotType": controller.arm.model.name},
    ),
    api.VERSIONS: ((10, 14), lambda controller: {"marketingVersion": ".".join(map(str, controller.installed.version[:3]))}),
}
"""For each path that can be read: the first PolyScope that has it, and the answer."""


def reply(controller: Controller, method: str, path: str, body: bytes) -> Answer:
    """Status and content of the answer to one request."""
    path = path.removeprefix(api.ROOT)
    if method == "GET":
        first, answer = ANSWERS.get(path, ((99, 0), _described))
        return (200, answer(controller)) if controller.installed.version >= first else (404, {"message": "no such path"})
    actions = {api.PROGRAM: PROGRAM_ACTIONS, STATE: STATE_ACTIONS}.get(path)
    if method != "PUT" or actions is None:
        return 404, {"message": "no such path"}
    try:
        order = actions[json.loads(body)["action"]]
    except (ValueError, KeyError, TypeError):
        return 422, {"message": f"action: one of {', '.join(actions)}"}
    if not controller.installed.remote:
        return 403, {"message": "the robot is not in remote control"}
    done = dashboard.reply(controller, order)
    return (409 if done.startswith("Failed") else 200), {"message": done}


async def serve(controller: Controller, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Answer one request; a controller without the API closes the connection."""
    if not (controller.installed.robot_api and controller.installed.version >= api.FIRST_VERSION):
        return
    head = await reader.readuntil(b"\r\n\r\n")
    method, path, _ = head.split(b"\r\n", 1)[0].decode("latin-1").split(" ", 2)
    lengths = [line.split(b":")[1] for line in head.split(b"\r\n") if line.lower().startswith(b"content-length:")]
    body = await reader.readexactly(min(int(lengths[0]), LONGEST)) if lengths else b""
    status, content = reply(controller, method, path, body)
    data = json.dumps(content).encode()
    writer.write(f"HTTP/1.1 {status} {REASONS[status]}\r\nContent-Type: application/json\r\n".encode())
    writer.write(f"Content-Length: {len(data)}\r\nConnection: close\r\n\r\n".encode() + data)
    await writer.drain()
