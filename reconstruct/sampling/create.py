"""The one place that knows the samplers by their names."""

from typing import Any

from jaxtyping import PRNGKeyArray
from numpy.typing import NDArray

from koala3d.reconstruct.config import Config, SamplerConfig
from koala3d.reconstruct.sampling.occupied_steps import OccupiedSteps
from koala3d.reconstruct.sampling.proposed_intervals import ProposedIntervals
from koala3d.reconstruct.sampling.sampler import Sampler
from koala3d.reconstruct.scene.facts import SceneFacts

SAMPLERS: dict[str, type[Sampler]] = {"occupancy": OccupiedSteps, "proposal": ProposedIntervals}


def sampler_type(config: SamplerConfig) -> type[Sampler]:
    """The sampler that a configuration names."""
    return SAMPLERS[config.kind]


def create(
    key: PRNGKeyArray, config: Config, facts: SceneFacts, possible: NDArray[Any] | None = None, density_bias: float = 0.0
) -> Sampler:
    """A fresh sampler.

    Args:
        possible: cells that can hold anything, see `Sampler.possible_cells`.
        density_bias: added to the raw density of proposals.
    """
    return sampler_type(config.sampler).create(key, config, facts, possible, density_bias)
