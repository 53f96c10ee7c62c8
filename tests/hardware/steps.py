"""One step of the acceptance protocol, what it measured, and what an operator is asked before it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"
Ask = Callable[[str], bool]
"""Shows an operator what comes next; False: skip it."""


@dataclass(frozen=True)
class Step:
    """What was measured in one step."""

    name: str
    verdict: str
    found: str
    measured: dict[str, Any] = field(default_factory=dict)


def judged(name: str, good: bool, found: str, **measured: Any) -> Step:
    """Passed or failed."""
    return Step(name, PASSED if good else FAILED, found, measured)


def skipped(name: str, why: str) -> Step:
    """Not done."""
    return Step(name, SKIPPED, why)
