"""What a check finds: what, where, how bad, and how to mend it."""

from dataclasses import dataclass

from datasets.core.errors import KoalaError


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong ("error") or looks wrong ("warning")."""

    level: str
    what: str
    where: str
    why: str = ""
    remedy: str = ""

    @property
    def line(self) -> str:
        """All of it in one line."""
        return f"{self.level}: {KoalaError(self.what, where=self.where, why=self.why, remedy=self.remedy)}"


def from_error(error: KoalaError) -> Finding:
    """An error of a reader as a finding."""
    return Finding("error", error.what, error.where, error.why, error.remedy)
