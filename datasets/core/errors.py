"""One family of errors that say what went wrong, where, why, and what to do about it."""

from collections.abc import Iterable


class KoalaError(Exception):
    """An error meant for a person: one line with everything needed to fix it.

    Args:
        what: what is wrong, without a full stop ("pose is not finite").
        where: the file, key or frame in question ("scene/cameras.json, frame 12").
        why: the value or circumstance that proves it ("translation is [nan, 0, 0]").
        remedy: what to do next ("record the frame again").
    """

    exit_code = 1

    def __init__(self, what: str, *, where: object = "", why: str = "", remedy: str = "") -> None:
        self.what, self.where, self.why, self.remedy = what, str(where), why, remedy
        place = f"{self.where}: " if self.where else ""
        reason = f" ({why})" if why else ""
        advice = f"; {remedy}" if remedy else ""
        super().__init__(" ".join(f"{place}{what}{reason}{advice}".split()))


class UsageError(KoalaError):
    """Invalid input to a command: a missing file, a wrong key, an impossible value."""

    exit_code = 2


class DatasetError(KoalaError):
    """A file or folder violates its format."""


def nearest(name: str, valid: Iterable[object]) -> str:
    """Advice that names the closest valid spelling, or all of them where none is close."""
    from difflib import get_close_matches

    names = sorted(map(str, valid))
    close = get_close_matches(name, names, n=1, cutoff=0.6)
    return f"did you mean '{close[0]}'?" if close else f"valid: {', '.join(names)}"
