"""What a check says: one line of the table."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from koala3d.datasets.core.errors import UsageError

CONTROLLER = "controller"
"""Name of the line about a controller that does not answer at all."""


class Verdict(StrEnum):
    """Of one check."""

    OK = "ok"
    WRONG = "wrong"
    UNKNOWN = "unknown"
    IGNORED = "ignored"  # wrong, and a person goes on all the same


@dataclass(frozen=True)
class Line:
    """One check: what was found, and what to do where that is wrong or cannot be known."""

    name: str
    verdict: Verdict
    found: str
    remedy: str = ""
    blocks: bool = True
    """Whether `capture run` refuses to start where the verdict is wrong; else it warns."""


def ok(name: str, found: str) -> Line:
    """Nothing to do."""
    return Line(name, Verdict.OK, found)


def wrong(name: str, found: str, remedy: str, *, blocks: bool = True) -> Line:
    """Must be mended, or, without `blocks`, makes the recording worse."""
    return Line(name, Verdict.WRONG, found, remedy, blocks)


def unknown(name: str, found: str, remedy: str) -> Line:
    """Nobody could say, or nothing was there to compare with."""
    return Line(name, Verdict.UNKNOWN, found, remedy)


def judged(name: str, good: bool, found: str, remedy: str, *, blocks: bool = True) -> Line:
    """`ok` or `wrong`."""
    return ok(name, found) if good else wrong(name, found, remedy, blocks=blocks)


def compared(name: str, found: str, stated: str, key: str) -> Line:
    """A value that the rig file may state: wrong where it states another one, unknown where it states none."""
    if not stated:
        return unknown(name, found, f"write {key}: '{found}' into the rig file, to have it compared")
    return judged(name, found == stated, found, f"the rig file states {stated} in {key}: find out which is right")


def ignoring(lines: Iterable[Line], names: Collection[str]) -> list[Line]:
    """The lines; those of `names` that are wrong are called ignored. Raises UsageError: no line has one of the names."""
    listed = list(lines)
    known = {line.name for line in listed}
    if (unknown := sorted(set(names) - known)) and CONTROLLER not in known:  # without a controller most lines are missing
        why = f"the lines are {', '.join(line.name for line in listed)}"
        raise UsageError(f"no line of 'capture doctor' is called '{unknown[0]}'", where="--ignore", why=why)
    given = {line.name for line in listed if line.verdict is Verdict.WRONG and line.name in names}
    return [replace(line, verdict=Verdict.IGNORED) if line.name in given else line for line in listed]


def table(lines: Iterable[Line]) -> str:
    """The lines below each other, names and verdicts aligned, each remedy behind what was found."""
    listed = list(lines)
    width = max(len(line.name) for line in listed)
    return "\n".join(
        f"{line.name:{width}}  {line.verdict:7}  {line.found}" + (f"; {line.remedy}" if line.remedy else "") for line in listed
    )
