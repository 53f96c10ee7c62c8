"""Checks of what a person sets at the pendant: control, program, payload, tool."""

from typing import Any

import numpy as np

from koala3d.capture.doctor.lines import Line, judged, ok, unknown, wrong
from koala3d.capture.doctor.report import ControllerReport
from koala3d.capture.drivers.ur.interfaces.robot_api import FIRST_VERSION, RobotApi
from koala3d.capture.drivers.ur.pendant import BUSY
from koala3d.capture.drivers.ur.stand_in import program_state
from koala3d.capture.model.rig import InstallationDescription

POLYSCOPE_X = 10
"""Its first major version."""
PAYLOAD_KG, CENTRE_M, TOOL_M, TOOL_RAD = 0.05, 0.01, 1e-4, 1e-3
"""What may differ from the rig file: payload and its centre by the accuracy of scales and rulers, the tool offset by rounding."""


def check(answers: ControllerReport, stated: InstallationDescription) -> list[Line]:
    """The lines."""
    return [*_control(answers), *_payload(answers.sample, stated), _tool(answers, stated)]


def _control(answers: ControllerReport) -> list[Line]:
    if (replies := answers.dashboard) is None:
        lines = [_missing_dashboard(answers), *_modes(answers.api)]
        programs = ["STOPPED" if answers.sample is None else program_state(answers.sample["runtime_state"])]
        programs += [answers.api.program_state] if answers.api is not None else []
        program = next((one for one in programs if one.startswith(BUSY)), "STOPPED")
    else:
        lines = [ok("dashboard", f"{answers.host} answers")]
        lines.append(_remote(replies["is in remote control"].strip().lower() == "true"))
        program = replies["programState"]
    running = program.startswith(BUSY)
    remedy = "wait for it, stop it at the pendant, or let 'capture run --take-over' end it"
    lines.append(judged("program", not running, program if running else "none runs", remedy))
    return lines


def _remote(is_remote: bool) -> Line:
    found = "in remote control" if is_remote else "in local control"
    return judged("remote control", is_remote, found, "choose remote control at the pendant, top right")


def _modes(api: RobotApi | None) -> list[Line]:
    """Who has control, and the operational mode, as the Robot API says them."""
    if api is None or not api.control_mode:
        return [unknown("remote control", "only a dashboard or PolyScope X 10.12 says it", "see the top right of the pendant")]
    found, remedy = f"{api.operational_mode.lower()} mode", "choose the automatic mode: in the manual one programs run slowly"
    return [_remote(api.control_mode == "REMOTE"), judged("operational mode", api.operational_mode != "MANUAL", found, remedy)]


def _missing_dashboard(answers: ControllerReport) -> Line:
    version = answers.primary.version if answers.primary is not None else None
    if answers.api is not None:
        return ok("dashboard", f"PolyScope X has none: its Robot API answers (version {answers.api.version})")
    if version is not None and FIRST_VERSION <= version:
        return unknown("dashboard", "the Robot API of PolyScope X does not answer", "open its service in the security settings")
    if version is not None and version[0] >= POLYSCOPE_X:
        found = "PolyScope X has none, and no Robot API before 10.11: RTDE and the primary interface stand in, client koala"
        return ok("dashboard", found)
    remedy = "enable it under Settings > Security > Services; PolyScope X has none, but says its version on the primary interface"
    return wrong("dashboard", f"no dashboard server at {answers.host}", remedy)


def _payload(sample: dict[str, Any] | None, stated: InstallationDescription) -> list[Line]:
    names = "payload", "centre of gravity"
    if sample is None:
        return [unknown(name, "no samples", "enable RTDE at the pendant") for name in names]
    mass, centre = float(sample["payload"]), np.array(sample["payload_cog"])
    found = f"{mass:.2f} kg", f"({', '.join(f'{1e3 * one:.0f}' for one in centre)}) mm"
    if mass == 0:
        remedy = "weigh camera, lens and bracket and enter them at the pendant: Installation > General > Payload"
        return [wrong(names[0], "none entered", remedy), unknown(names[1], "of no payload", "enter the payload first")]
    remedy = "enter at the pendant what the rig file states, or correct the rig file"
    if stated.payload_kg is None:
        first = unknown(names[0], found[0], "write robot.installation.payload_kg into the rig file, to have it compared")
    else:
        good = abs(mass - stated.payload_kg) <= PAYLOAD_KG
        first = judged(names[0], good, f"{found[0]}, stated {stated.payload_kg:.2f} kg", remedy)
    if stated.payload_centre is None:
        second = unknown(names[1], found[1], "write robot.installation.payload_centre into the rig file, to have it compared")
    else:
        good = bool(np.abs(centre - stated.payload_centre).max() <= CENTRE_M)
        second = judged(
            names[1], good, f"{found[1]}, stated ({', '.join(f'{1e3 * one:.0f}' for one in stated.payload_centre)})", remedy
        )
    return [first, second]


def _tool(answers: ControllerReport, stated: InstallationDescription) -> Line:
    name = "tool offset"
    if answers.primary is None or answers.primary.tcp_offset is None:
        return unknown(name, "the controller does not say it", "enable Primary/Secondary at the pendant")
    offset = answers.primary.tcp_offset
    found = f"({', '.join(f'{1e3 * one:.1f}' for one in offset[:3])}) mm, ({', '.join(f'{one:.3f}' for one in offset[3:])}) rad"
    wanted = np.zeros(6) if stated.tool_offset is None else np.array(stated.tool_offset)
    if stated.tool_offset is None and offset.any():
        return unknown(name, found, "Koala removes it from poses; write robot.installation.tool_offset, to have it compared")
    good = np.abs(offset[:3] - wanted[:3]).max() <= TOOL_M and np.abs(offset[3:] - wanted[3:]).max() <= TOOL_RAD
    return judged(name, bool(good), found, "choose the tool centre point that robot.installation.tool_offset states")
