"""Emission and absorption along a ray: from densities to weights."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from reconstruct.numerics.sums import sum_before

OPAQUE = 80.0
"""Optical depth at which an interval counts as opaque: exp(-80) is 0 beside anything that float32 can show."""


def volume_weights(density: Float[Array, "rays samples"], lengths: Float[Array, "rays samples"]) -> Float[Array, "rays samples"]:
    """Share of a ray's colour that each interval contributes.

    Emission and absorption with density constant inside an interval (NeRF, Mildenhall et al. 2020, equation 3):

        weights[i] = (1 - exp(-d[i])) exp(-sum(d[:i])),   d[i] = density[i] lengths[i].

    The second factor is a sum in the exponent, not a product of (1 - alpha): equal in exact arithmetic, but it keeps the
    faint light that float32 loses once alpha rounds to 1.

    Args:
        density: at least 0 [1 / scene unit].
        lengths: at least 0 [scene unit]; zero length gives weight 0 whatever the density.

    Returns:
        Weights in [0, 1], summing to at most 1; one minus the sum is what the background receives.
    """
    depth = jnp.minimum(density * lengths, OPAQUE)
    return -jnp.expm1(-depth) * jnp.exp(-sum_before(depth))
