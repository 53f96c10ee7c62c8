"""Which space is ruled out before the first step: what masks vote out, or what too few cameras see."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.reconstruct.config import Config
from koala3d.reconstruct.sampling.create import sampler_type
from koala3d.reconstruct.sampling.occupancy import cell_centres
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.decisions.skip import Skip

NAME, WHAT = "empty_rays", "empty space"
SAVING = "samples in there, and rays that meet nothing else"


def decided(normalisation: Normalisation, possible: NDArray[np.bool_] | None, config: Config) -> Skip:
    """The decision, with the share of the space that is ruled out.

    Args:
        possible: cells that can hold anything, see `Sampler.possible_cells`.
    """
    if not sampler_type(config.sampler).rules_out_space:
        return Skip(NAME, WHAT, False, "proposals have no grid", SAVING)
    if not config.skip.empty_rays:
        return Skip(NAME, WHAT, False, "forced", SAVING)
    by = "masks rule out" if normalisation.bounded else "too few cameras see"
    return Skip(NAME, WHAT, True, f"{by} {1 - _share(normalisation, possible):.0%} of the space", SAVING)


def _share(normalisation: Normalisation, possible: NDArray[np.bool_] | None) -> float:
    """Share of the cells that can hold anything; with an outer grid, of those around the object."""
    if possible is None:
        return 1.0
    if normalisation.space.single_grid:
        return float(possible.mean())
    outside = np.linalg.norm(cell_centres(round(len(possible) ** (1 / 3)), 2.0), axis=-1)
    return float(possible[(outside > 1) & (outside < 2)].mean())


def with_outcome(skips: Sequence[Skip], line: dict[str, Any]) -> list[Skip]:
    """The decisions of a training that has ended, with how much was empty at last.

    Args:
        line: the newest line of the run's log.
    """
    if "occupied" not in line:
        return list(skips)
    words = f"in the end {1 - line['occupied']:.0%} of it was empty"
    return [
        replace(skip, evidence=f"{skip.evidence}; {words}")
        if skip.name == NAME and skip.skipped and words not in skip.evidence
        else skip
        for skip in skips
    ]
