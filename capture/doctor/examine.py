"""All checks of a rig together: what a person asks for, and what a session asks before it begins."""

import logging
from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from koala3d.capture.doctor import arm, camera, computer, pendant, safety
from koala3d.capture.doctor.lines import CONTROLLER, Line, Verdict, ignoring, ok, unknown, wrong
from koala3d.capture.doctor.report import ControllerReport, ask
from koala3d.capture.drivers.cameras.base import InspectedCamera
from koala3d.capture.drivers.errors import CaptureError, NotReady
from koala3d.capture.drivers.ur.client import is_vendors
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.sim.camera_nodes import SimulatedNodes

log = logging.getLogger(__name__)
BRIEFLY_S = 0.3  # how long samples are watched before a session
SESSION_BYTES = 1e9  # a session of the whole sensor takes 0.3 GB
SIMULATED_PATIENCE = 10  # the computer of a simulation is busy with rendering: gaps of its samples may be so much longer
PROGRAM = "program"  # name of the line that `take_over` answers


def examine_arm(
    host: str,
    rig: RigDescription,
    *,
    folder: Path,
    seconds: float,
    needed: float = SESSION_BYTES,
    longest_gap_s: float | None = None,
    rate: float | None = 1.0,
    up: int | None = None,
    now: Callable[[], datetime] = lambda: datetime.now(UTC),
) -> list[Line]:
    """Ask the controller at `host`, and this computer; nothing moves.

    Args:
        seconds: how long samples are watched.
        up: sign of the base's z axis in the upward direction that the session needs; None: the rig file's.
        longest_gap_s: between two samples; None: the rig file's.
        folder, needed, rate: see `capture.doctor.computer.check`.
    """
    answers = ask(host, seconds)
    if answers.dashboard is None and answers.primary is None and answers.sample is None:
        remedy = "check that it is switched on, the cable, and robot.host in the rig file"
        return [wrong(CONTROLLER, f"{host}: {answers.silent[0]}", remedy)]
    stated = rig.robot.installation
    longest_gap_s = rig.robot.stream_deadline_s if longest_gap_s is None else longest_gap_s
    return [
        *_ports(answers, rig.robot.client),
        *arm.check(answers, rig.robot, up),
        *pendant.check(answers, stated),
        *safety.check(answers, stated),
        *computer.check(answers, folder, needed=needed, now=now(), longest_gap_s=longest_gap_s, rate=rate),
    ]


def examine(
    rig: RigDescription,
    host: str,
    folder: Path,
    *,
    simulated: bool,
    seconds: float,
    needed: float = SESSION_BYTES,
    up: int | None = None,
    encoded: bool = True,
    cameras: bool = True,
) -> list[Line]:
    """Arm, computer and every camera; arguments as in `examine_arm`.

    Args:
        encoded: whether cameras must send sRGB.
        cameras: whether they are asked at all.

    A simulated camera is librealsense's software device, or for all other drivers an ace USB over pylon's emulation.
    """
    gap_s = rig.robot.stream_deadline_s * (SIMULATED_PATIENCE if simulated else 1)
    rate = None if simulated else 1.0
    if rig.arm.family == "ur":
        lines = examine_arm(host, rig, folder=folder, seconds=seconds, needed=needed, longest_gap_s=gap_s, rate=rate, up=up)
    else:
        found = f"Koala has no driver for the {rig.arm.name}"
        lines = [unknown(CONTROLLER, found, "simulate it by '--rig sim:NAME'; only arms of Universal Robots are driven")]
    for number, (name, one) in enumerate(rig.each.items() if cameras else ()):
        found = _examined(one, number if simulated else None, encoded=encoded, cameras=len(rig.each))
        lines += [_of_camera(name, line) for line in found] if name else found
    return lines


def _of_camera(name: str, line: Line) -> Line:
    """The line of one of several cameras, with its keys of the rig file."""
    return replace(line, name=f"{name} {line.name}", remedy=line.remedy.replace("camera.", f"cameras.{name}."))


def _examined(rig: RigDescription, number: int | None, *, encoded: bool, cameras: int) -> list[Line]:
    """The lines of the camera, which is opened only for them; `number` of a simulated one, None of a real one."""
    from koala3d.capture.rig.cameras import seen

    simulated = number is not None
    with ExitStack() as stack:
        try:
            found = stack.enter_context(seen(rig.camera, simulated=simulated, number=number or 0))
        except CaptureError as error:
            return camera.missing(f"{error.what} ({error.why})" if error.why else error.what)
        return _camera(found, rig, simulated=simulated, encoded=encoded, cameras=cameras)


def _camera(found: InspectedCamera, rig: RigDescription, *, simulated: bool, encoded: bool, cameras: int) -> list[Line]:
    genicam = rig.camera.model in ("basler", "genicam") or (simulated and rig.camera.model != "realsense")
    nodes = SimulatedNodes(found.nodes, "ace USB") if simulated and genicam else found.nodes
    shared = {"cameras": cameras, "usb_mb": camera.usbfs_memory_mb()}
    return camera.check(nodes, found.serial, found.facts, rig.camera, encoded=encoded, genicam=genicam, **shared)


def examination(
    out: Path,
    up: int,
    encoded: bool = True,
    take_over: bool = False,
    *,
    ignore: Collection[str] = (),
    cameras: bool = True,
) -> Callable[[RigDescription, str, bool], dict[str, str]]:
    """The checks at the start of a session that writes to `out`, for `open_rig` and `open_arm`: silent if nothing is wrong.

    They return what was found to be wrong and is ignored, by the names of the lines.
    """

    def checked(rig: RigDescription, host: str, simulated: bool) -> dict[str, str]:
        # the recorder knows how much each view takes, and refuses a disk without room
        session = partial(examine, seconds=BRIEFLY_S, needed=0.0, up=up, encoded=encoded, cameras=cameras)
        lines = ignoring(session(rig, host, out, simulated=simulated), ignore)
        refuse_wrong(lines, host, take_over=take_over)
        return {line.name: line.found for line in lines if line.verdict is Verdict.IGNORED}

    return checked


def refuse_wrong(lines: list[Line], where: str, *, take_over: bool = False) -> None:
    """Warn of what makes a recording worse; raise NotReady where something must be mended first.

    Args:
        take_over: a program that runs is no hindrance.
    """
    for line in lines:
        if line.verdict is Verdict.IGNORED:
            log.warning("%s: %s; ignored", line.name, line.found)
    bad = [line for line in lines if line.verdict is Verdict.WRONG and not (take_over and line.name == PROGRAM)]
    for line in bad:
        if not line.blocks:
            log.warning("%s: %s; %s", line.name, line.found, line.remedy)
    blocking = [line for line in bad if line.blocks]
    if blocking:
        why = "; ".join(f"{line.name}: {line.found}" for line in blocking)
        remedy = "; ".join(dict.fromkeys(line.remedy for line in blocking))
        raise NotReady("the rig is not ready, nothing has moved", where=where, why=why, remedy=remedy)


def _ports(answers: ControllerReport, client: str) -> list[Line]:
    """Which interfaces answer; `client`: what the rig file chooses."""
    samples = ok("RTDE", "sends samples")
    if answers.sample is None:
        samples = wrong("RTDE", "no samples", "enable RTDE at the pendant: Settings > Security > Services")
    primary = ok("primary interface", "sends the state")
    if answers.primary is None or not answers.primary.heard:
        remedy = "enable Primary/Secondary at the pendant: Settings > Security > Services"
        primary = unknown("primary interface", "says nothing", remedy)
        if not is_vendors(client):
            primary = wrong("primary interface", "says nothing, and would take no program from the client koala", remedy)
    return [samples, primary]
