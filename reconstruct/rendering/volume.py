"""Volume rendering: from densities along rays to weights, and from weights to whatever is composited."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from reconstruct.sampling.samples import RaySamples


def volume_weights(density: Float[Array, "rays samples"], lengths: Float[Array, "rays samples"]) -> Float[Array, "rays samples"]:
    """Share of a ray's colour that each interval contributes.

    Emission and absorption with density constant inside an interval (NeRF, Mildenhall et al. 2020, equation 3):

        weights[i] = (1 - exp(-d[i])) exp(-sum(d[:i])),   d[i] = density[i] lengths[i].

    The second factor is a sum in the exponent, not a product of (1 - alpha): equal in exact arithmetic, but it keeps the
    faint light that float32 loses once alpha rounds to 1. The sum is a product with a triangular matrix, which on
    short rays is faster than a scan.

    Args:
        density: at least 0 [1 / scene unit].
        lengths: at least 0 [scene unit]; zero length gives weight 0 whatever the density.

    Returns:
        Weights in [0, 1], summing to at most 1; one minus the sum is what the background receives.
    """
    depth = jnp.minimum(density * lengths, 80.0)  # exp(-80) is 0 beside anything that float32 can show
    earlier = jnp.asarray(np.triu(np.ones((depth.shape[-1],) * 2, np.float32), 1), depth.dtype)
    before = jnp.matmul(depth, earlier, precision="highest")  # a GPU would round the factors to ten bits otherwise
    return -jnp.expm1(-depth) * jnp.exp(-before)


def sample_weights(density: Float[Array, " n"], samples: RaySamples, speed: Float[Array, " rays"]) -> Float[Array, "rays slots"]:
    """`volume_weights` of packed samples; `speed` is the length of each ray's direction [scene unit per t]."""
    return volume_weights(samples.padded(density), samples.padded(samples.length) * speed[:, None])


def composite(
    values: Float[Array, "channels n"], weights: Float[Array, " n"], samples: RaySamples
) -> Float[Array, "rays channels"]:
    """Sum of weighted sample values over each ray."""
    rows = (values * weights).T
    return jnp.zeros((samples.num_rays, values.shape[0]), values.dtype).at[samples.ray].add(rows, mode="promise_in_bounds")
