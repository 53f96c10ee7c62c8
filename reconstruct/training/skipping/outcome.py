"""What a training found out about its skips while it went on."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from reconstruct.config import SurfaceConfig
from reconstruct.training.skipping.record import Skip

AGREE = 2e-4
"""Mean of (1 - |n . n'|) / 2 around the surfaces below which normals agree already: 1.6 degrees in the mean."""
LONGEST = 4
"""Second passes are at most this many times rarer than in the curriculum."""


def lenience(before: int, terms: dict[str, Any], surface: SurfaceConfig) -> int:
    """How many times later the next second pass comes, from what the last one found; 1 as soon as normals disagree."""
    agree = surface.normal > 0 and float(terms["normal_consistency"]) <= AGREE * surface.normal
    return min(2 * before, LONGEST) if agree else 1


def with_outcome(skips: Sequence[Skip], line: dict[str, Any], *, passes: int, left_out: int) -> list[Skip]:
    """The decisions with what came of them.

    Args:
        line: the newest line of the run's log.
        passes: second passes that ran, and `left_out`, how many more there would have been.
    """
    added = {
        "consistent_passes": f"{left_out} of {passes + left_out} second passes were left out" if left_out else "",
        "converged": f"stopped after {line['progress']:.0%} of the training" if line["progress"] < 1 else "",
        "empty_rays": f"in the end {1 - line['occupied']:.0%} of it was empty" if "occupied" in line else "",
    }
    return [_with(skip, added.get(skip.name, "")) for skip in skips]


def _with(skip: Skip, words: str) -> Skip:
    """The decision with more evidence, unless it says so already or nothing was skipped."""
    if not (words and skip.skipped) or words in skip.evidence:
        return skip
    return replace(skip, evidence=f"{skip.evidence}; {words}")
