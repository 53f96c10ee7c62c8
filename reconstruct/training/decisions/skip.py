"""One decision, as RUN/skips.json keeps it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Skip:
    """Something that a training does for some scenes and not for others."""

    name: str
    what: str
    """What it is, in words for everybody."""
    skipped: bool
    evidence: str
    """What the decision rests on, with figures."""
    saving: str = ""
    """What leaving it out saves, or would; empty: nothing, since it is done for scenes that need it and no others."""
