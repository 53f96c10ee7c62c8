"""All checks of a rig together: one examination, and what it means for a session that is about to begin."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from capture.doctor import arm, computer, pendant, safety
from capture.doctor.answers import Answers, ask
from capture.doctor.lines import Line, Verdict, ok, unknown, wrong
from capture.errors import NotReady
from capture.rig.description import RigDescription
from capture.robots.timing import Deadlines

log = logging.getLogger(__name__)
LISTEN_S, BRIEFLY_S = 5.0, 0.3
"""How long the samples are watched: for a person who asks, and before a session."""
PROGRAM = "program"  # name of the line that `take_over` answers


@dataclass(frozen=True)
class Place:
    """Where a recording will be, and what it needs there."""

    folder: Path = Path()
    needed: float = 1e9  # bytes; a session of the whole sensor takes 0.3 GB


def examine(
    rig: RigDescription, host: str, place: Place, *, simulated: bool, up: int | None = None, seconds: float = LISTEN_S
) -> list[Line]:
    """Ask the controller at `host` and this computer; nothing moves.

    Args:
        simulated: its clock may run at any rate, and its computer is busy with rendering.
        up: sign of the base's z axis in the upward direction that the session needs; None: the rig file's.
        seconds: how long samples are watched.
    """
    answers = ask(host, seconds)
    if answers.dashboard is None and answers.primary is None and answers.sample is None:
        remedy = "check that it is switched on, the cable, and robot.host in the rig file"
        return [wrong("controller", f"{host}: {answers.silent[0]}", remedy)]
    stated = rig.robot.installation
    gap_s = Deadlines().stale_s * (10 if simulated else 1)
    return [
        *_ports(answers),
        *arm.check(answers, rig.robot, up),
        *pendant.check(answers, stated),
        *safety.check(answers, stated),
        *computer.check(
            answers,
            place.folder,
            needed=place.needed,
            now=datetime.now(UTC),
            longest_gap_s=gap_s,
            rate=None if simulated else 1.0,
        ),
    ]


def examination(out: Path, up: int, take_over: bool) -> Callable[[RigDescription, str, bool], None]:
    """The checks at the start of a session that writes to `out`, for `open_rig`: silent where nothing is wrong."""

    def checked(rig: RigDescription, host: str, simulated: bool) -> None:
        place = Place(out, 0.0)  # the recorder knows how much each view takes, and refuses a disk without room
        lines = examine(rig, host, place, simulated=simulated, up=up, seconds=BRIEFLY_S)
        require_fit(lines, host, take_over=take_over)

    return checked


def require_fit(lines: list[Line], where: str, *, take_over: bool) -> None:
    """Warn of what makes a recording worse; raise NotReady where something must be mended first.

    Args:
        take_over: a program that runs is no hindrance.
    """
    bad = [line for line in lines if line.verdict is Verdict.WRONG and not (take_over and line.name == PROGRAM)]
    for line in bad:
        if not line.blocks:
            log.warning("%s: %s; %s", line.name, line.found, line.remedy)
    blocking = [line for line in bad if line.blocks]
    if blocking:
        why = "; ".join(f"{line.name}: {line.found}" for line in blocking)
        remedy = "; ".join(dict.fromkeys(line.remedy for line in blocking))
        raise NotReady("the rig is not ready, nothing has moved", where=where, why=why, remedy=remedy)


def _ports(answers: Answers) -> list[Line]:
    """Which interfaces answer."""
    samples = ok("RTDE", "sends samples")
    if answers.sample is None:
        samples = wrong("RTDE", "no samples", "enable RTDE at the pendant: Settings > Security > Services")
    primary = ok("primary interface", "sends the state")
    if answers.primary is None or not answers.primary.heard:
        remedy = "enable Primary/Secondary at the pendant: Settings > Security > Services"
        primary = unknown("primary interface", "says nothing", remedy)
    return [samples, primary]
