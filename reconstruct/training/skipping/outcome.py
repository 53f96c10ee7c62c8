"""What a training found out about its skips while it went on."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from koala3d.reconstruct.training.skipping.record import Skip


def with_outcome(skips: Sequence[Skip], line: dict[str, Any]) -> list[Skip]:
    """The decisions with what came of them.

    Args:
        line: the newest line of the run's log.
    """
    added = {"empty_rays": f"in the end {1 - line['occupied']:.0%} of it was empty" if "occupied" in line else ""}
    return [_with(skip, added.get(skip.name, "")) for skip in skips]


def _with(skip: Skip, words: str) -> Skip:
    """The decision with more evidence, unless it says so already or nothing was skipped."""
    if not (words and skip.skipped) or words in skip.evidence:
        return skip
    return replace(skip, evidence=f"{skip.evidence}; {words}")
