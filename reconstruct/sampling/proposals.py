"""Proposal levels: small density fields that tell where the final samples go (Mip-NeRF 360; Zip-NeRF)."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from koala3d.reconstruct.config import EncodingConfig
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.encodings.create import create_encoding
from koala3d.reconstruct.field.encodings.encoding import Encoding
from koala3d.reconstruct.field.mlp import Mlp
from koala3d.reconstruct.numerics.safe import safe_exp
from koala3d.reconstruct.numerics.stepfun import inverse_power_ladder, power_ladder, sample_intervals
from koala3d.reconstruct.numerics.volume import volume_weights
from koala3d.reconstruct.scene.bounds import Bounds
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Space

Level = tuple[Float[Array, "rays _"], Float[Array, "rays _"]]
"""Normalised edges and weights of a proposal level."""


class Proposal(eqx.Module):
    """Density alone, from an encoding of the field's kind (grids with one feature per level)."""

    encoding: Encoding
    spatial: Mlp
    density_bias: float = eqx.field(static=True)

    @classmethod
    def create(
        cls,
        key: PRNGKeyArray,
        encoding: EncodingConfig,
        finest: float,
        density_bias: float,
        *,
        width: int = 64,
        depth: int = 1,
    ) -> "Proposal":
        """One level whose finest resolution is `finest`; a factor 2 between its grids."""
        encoding_key, spatial_key = jax.random.split(key)
        levels = max(2, round(np.log2(finest / encoding.coarsest)) + 1)
        sizes = encoding.model_copy(update={"levels": levels, "features": 1, "finest": finest})
        encoded = create_encoding(encoding_key, sizes)
        network = Mlp.create(spatial_key, channels=encoded.num_channels, width=width, depth=depth, outputs=1)
        return cls(encoded, network, density_bias)

    def density(self, cloud: Cloud) -> Float[Array, " n"]:
        """Density [1 / scene unit]."""
        return safe_exp(self.spatial(cloud.encoded(self.encoding))[0] + self.density_bias)


class Spacing(eqx.Module):
    """The map between metric distance t and normalised distance s in [0, 1] of a ray."""

    near: Float[Array, ""]
    far: Float[Array, ""]
    linear: bool = eqx.field(static=True)

    @classmethod
    def of(cls, bounds: Bounds, space: Space) -> "Spacing":
        """Linear for bounded scenes; a power ladder (p = -1.5, premultiplier 2) for unbounded ones."""
        return cls(bounds.near, bounds.far, space.bounded)

    def t(self, s: Float[Array, "..."]) -> Float[Array, "..."]:
        """Metric distance of normalised distance."""
        if self.linear:
            return self.near + (self.far - self.near) * s
        first, last = (power_ladder(v, -1.5, 2.0) for v in (self.near, self.far))
        return inverse_power_ladder(first + (last - first) * s, -1.5, 2.0)


DensityAt = Callable[[Proposal, Rays, Float[Array, "rays edges"]], Float[Array, "rays _"]]


def propose(
    proposals: tuple[Proposal, ...],
    rays: Rays,
    spacing: Spacing,
    counts: tuple[int, ...],
    key: PRNGKeyArray | None,
    density_at: DensityAt,
) -> tuple[Float[Array, "rays edges"], tuple[Level, ...]]:
    """Normalised edges of the final intervals, and each proposal's (edges, weights) for the interlevel loss.

    Args:
        counts: intervals of each proposal level, then of the final one.
        key: jitter of each level, one number per ray; None puts every draw into the middle.
        density_at: densities of a proposal in the intervals of rays between distances t.
    """
    num_rays = rays.origins.shape[0]
    sdist = jnp.broadcast_to(jnp.array([0.0, 1.0]), (num_rays, 2))
    weights = jnp.ones((num_rays, 1))
    levels = []
    keys = [None] * len(counts) if key is None else list(jax.random.split(key, len(counts)))
    for level, (count, level_key) in enumerate(zip(counts, keys, strict=True)):
        uniforms = jnp.full(num_rays, 0.5) if level_key is None else jax.random.uniform(level_key, (num_rays,))
        sdist = sample_intervals(uniforms, sdist, weights, count)
        if level < len(proposals):
            tdist = spacing.t(sdist)
            lengths = jnp.diff(tdist, axis=-1) * rays.speed[:, None]
            weights = volume_weights(density_at(proposals[level], rays, tdist) * lengths)
            levels.append((sdist, weights))
    return sdist, tuple(levels)
