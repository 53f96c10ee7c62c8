"""The Robot API of PolyScope X, which has it where PolyScope 5 has a dashboard: JSON over HTTP (port 80).

PolyScope 10.11 has the state of programs, 10.12 (version 3.1.4 of the API) the modes of arm, safety and control, 10.14 (5.0.107)
serial number and software. Changes need remote control, else the answer is 403. Koala only reads, and stops programs: it releases
no stop, no brakes, and switches nothing on. (Universal Robots, Robot API and client library.)
"""

import json
import urllib.error
import urllib.request
from dataclasses import dataclass
from typing import Any

PORT, TIMEOUT_S = 80, 1.0
ROOT = "/universal-robots/robot-api"
FIRST_VERSION = (10, 11)
"""Of PolyScope X with a Robot API."""
LONGEST = 1 << 20  # bytes of an answer
DESCRIPTION, PROGRAM = "/openapi.json", "/program/v1/state"
ROBOT_MODE, SAFETY_MODE = "/robotstate/v1/robotmode", "/robotstate/v1/safetymode"
CONTROL_MODE, OPERATIONAL_MODE = "/system/v1/controlmode", "/system/v1/operationalmode"
INFORMATION, VERSIONS = "/system/v1/information", "/versions/v1"
_PLAIN = urllib.request.build_opener(urllib.request.ProxyHandler({}))  # a controller is not behind a proxy


@dataclass(frozen=True)
class RobotApi:
    """What it says; empty: this version of it does not say it."""

    version: str
    """Of the API."""
    program_state: str = ""
    """ "PLAYING", "PAUSED", "STOPPED"."""
    robot_mode: str = ""
    """By the names of the dashboard."""
    safety_mode: str = ""
    """ "NORMAL", "REDUCED", "PROTECTIVE_STOP", "EMERGENCY_STOP" or "FAULT"."""
    control_mode: str = ""
    """ "LOCAL" or "REMOTE"."""
    operational_mode: str = ""
    """ "MANUAL" or "AUTOMATIC"."""
    serial: str = ""
    software: str = ""


def ask(host: str) -> RobotApi | None:
    """All that it says; None: nobody answers there as a Robot API does."""
    described = _request(host, DESCRIPTION)
    version = described.get("info")
    if not isinstance(version, dict) or not version.get("version"):
        return None
    about = _request(host, INFORMATION)
    return RobotApi(
        str(version["version"]),
        _word(_request(host, PROGRAM), "state"),
        _word(_request(host, ROBOT_MODE), "mode"),
        _word(_request(host, SAFETY_MODE), "mode"),
        _word(_request(host, CONTROL_MODE), "mode"),
        _word(_request(host, OPERATIONAL_MODE), "mode"),
        _word(about, "serialNumber"),
        _word(_request(host, VERSIONS), "marketingVersion"),
    )


def stop(host: str) -> bool:
    """Order the controller to end its program; whether it accepted. It refuses in local control."""
    return bool(_request(host, PROGRAM, {"action": "stop"}))


def _word(answer: dict[str, Any], key: str) -> str:
    value = answer.get(key, "")
    return value if isinstance(value, str) else ""


def _request(host: str, path: str, change: dict[str, str] | None = None) -> dict[str, Any]:
    """The answer to a question, or to a `change`; empty: there is none, or it is refused."""
    body, headers = None if change is None else json.dumps(change).encode(), {"Content-Type": "application/json"}
    request = urllib.request.Request(
        f"http://{host}:{PORT}{ROOT}{path}", body, headers if body else {}, method="PUT" if body else "GET"
    )
    try:
        with _PLAIN.open(request, timeout=TIMEOUT_S) as reply:
            answer = json.loads(reply.read(LONGEST) or b"{}")
    except (OSError, ValueError, urllib.error.URLError):
        return {}
    answered = answer if isinstance(answer, dict) else {}
    return answered or {"message": "accepted"}
