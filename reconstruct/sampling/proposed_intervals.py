"""The sampler that goes by proposal levels: small fields, learned with the model, that say where its samples go."""

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from koala3d.datasets.scene import View
from koala3d.datasets.structure.masks.silhouette import Slack
from koala3d.reconstruct.config import Config, SamplerConfig
from koala3d.reconstruct.field.encodings.encoding import Encoding
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.sampling.proposals import Proposal, Spacing, propose
from koala3d.reconstruct.sampling.sampler import Batch, Sampled, Sampler
from koala3d.reconstruct.sampling.samples import Footprint, RaySamples, cloud_of
from koala3d.reconstruct.scene.bounds import Bounds
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Pixels, Rays
from koala3d.reconstruct.scene.space import Space


class ProposedIntervals(Sampler):
    """Each proposal's weights place the intervals of the next level; samples stand for the last level's intervals."""

    proposals: tuple[Proposal, ...]
    rays: int = eqx.field(static=True)
    counts: tuple[int, ...] = eqx.field(static=True)
    """Intervals of each proposal level, then of the final one."""
    bounds: Bounds
    space: Space = eqx.field(static=True)
    frustum: str = eqx.field(static=True)

    rules_out_space: ClassVar[bool] = False
    memory_grows_with_rays: ClassVar[bool] = True

    @classmethod
    def create(
        cls, key: PRNGKeyArray, config: Config, facts: SceneFacts, possible: Any, density_bias: float
    ) -> "ProposedIntervals":
        """Fresh proposals; `possible` is ignored."""
        sampler, encoding = config.sampler, config.encoding
        _, *keys = jax.random.split(key, 1 + len(sampler.proposal_finest))
        sizes = {"width": sampler.proposal_width, "depth": sampler.proposal_depth}
        proposals = tuple(
            Proposal.create(level_key, encoding, finest, density_bias, **sizes)
            for level_key, finest in zip(keys, sampler.proposal_finest, strict=True)
        )
        return cls(
            proposals=proposals,
            rays=sampler.rays,
            counts=(*sampler.proposals, sampler.final),
            space=facts.normalisation.space,
            bounds=Bounds.of(facts),
            frustum=sampler.frustum,
        )

    @classmethod
    def possible_cells(
        cls, config: Config, pixels: Pixels, views: tuple[View, ...], normalisation: Normalisation, slack: Sequence[Slack] | None
    ) -> None:
        """None: there are no cells."""
        return None

    @property
    def rays_drawn(self) -> int:
        """As configured."""
        return self.rays

    @property
    def samples_drawn(self) -> int:
        """Samples of the final level."""
        return self.rays * self.counts[-1]

    @property
    def divided_sizes(self) -> tuple[int, ...]:
        """Rays."""
        return (self.rays,)

    @classmethod
    def frustum_of(cls, config: SamplerConfig) -> str:
        """As configured."""
        return config.frustum

    @property
    def encodings(self) -> tuple[Encoding, ...]:
        """Those of the proposals."""
        return tuple(proposal.encoding for proposal in self.proposals)

    def pixels(self, pixels: Pixels, key: PRNGKeyArray) -> Int[Array, " drawn"]:
        """Random ones."""
        return jax.random.randint(key, (self.rays,), 0, pixels.total)

    def batch(self, rays: Rays, colour: Float[Array, "rays 4"], key: PRNGKeyArray, field: Field, looks: Bool[Array, ""]) -> Batch:
        """All rays. Their samples depend on the proposals, which are differentiated."""
        return Batch(rays, colour, jnp.ones(self.rays, bool), None)

    def sampled(self, batch: Batch, key: PRNGKeyArray) -> Sampled:
        """Samples jittered once per ray and level."""
        return self._sampled(batch.rays, key)

    def unjittered(self, rays: Rays) -> Sampled:
        """Samples in the middle of their strata."""
        found = self._sampled(rays, None)
        return Sampled(barrier(found.samples), found.footprint, found.fits)

    def _sampled(self, rays: Rays, key: PRNGKeyArray | None) -> Sampled:
        count, turn, spacing = rays.origins.shape[0], None, Spacing.of(self.bounds, self.space)
        if self.frustum == "hexagon":
            turn = jnp.zeros(count) if key is None else 2 * jnp.pi * jax.random.uniform(key, (count,))
        footprint = Footprint(self.frustum, turn)

        def density_at(proposal: Proposal, rays: Rays, tdist: Float[Array, "rays edges"]) -> Float[Array, "rays _"]:
            cloud = cloud_of(rays, RaySamples.from_edges(tdist), space=self.space, footprint=footprint)
            return proposal.density(cloud).reshape(tdist.shape[0], -1)

        edges, levels = propose(self.proposals, rays, spacing, self.counts, key, density_at)
        samples = RaySamples.from_edges(spacing.t(edges))
        return Sampled(samples, footprint, jnp.ones(count, bool), edges, levels)
