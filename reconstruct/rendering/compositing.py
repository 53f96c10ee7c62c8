"""From densities and values of packed samples to the rays that they lie on."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from reconstruct.numerics.volume import volume_weights
from reconstruct.sampling.samples import RaySamples


def sample_weights(density: Float[Array, " n"], samples: RaySamples, speed: Float[Array, " rays"]) -> Float[Array, "rays slots"]:
    """`volume_weights` of packed samples; `speed` is the length of each ray's direction [scene unit per t]."""
    return volume_weights(samples.padded(density), samples.padded(samples.length) * speed[:, None])


def composite(
    values: Float[Array, "channels n"], weights: Float[Array, " n"], samples: RaySamples
) -> Float[Array, "rays channels"]:
    """Sum of weighted sample values over each ray."""
    rows = (values * weights).T
    return jnp.zeros((samples.num_rays, values.shape[0]), values.dtype).at[samples.ray].add(rows, mode="promise_in_bounds")
