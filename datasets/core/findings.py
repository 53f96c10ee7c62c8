"""What a check finds: what is wrong, where, how serious it is, and how to fix it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from koala3d.datasets.core.errors import KoalaError


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong ("error") or looks wrong ("warning")."""

    level: str
    what: str
    where: str
    why: str = ""
    remedy: str = ""
    cause: str = ""
    """For programs: "pose", "intrinsics", "exposure", "white balance", "light", "motion", "blur", "mask", "coverage", "box" or
    "training"; empty for what concerns files."""
    evidence: dict[str, Any] = field(default_factory=dict)
    """What was measured, by name, for programs; "views" maps names of views to their figure."""

    @property
    def line(self) -> str:
        """The finding in one line."""
        return f"{self.level}: {KoalaError(self.what, where=self.where, why=self.why, remedy=self.remedy)}"


def from_error(error: KoalaError) -> Finding:
    """A reader's error as a finding."""
    return Finding("error", error.what, error.where, error.why, error.remedy)


def tally(findings: Sequence[Finding]) -> tuple[int, int]:
    """Number of errors and of warnings."""
    errors = sum(finding.level == "error" for finding in findings)
    return errors, len(findings) - errors
