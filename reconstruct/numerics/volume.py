"""Emission and absorption along a ray: from densities to weights."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

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


def sum_before(values: Float[Array, "rows n"], block: int | None = None) -> Float[Array, "rows n"]:
    """Sum of the entries of a row before each one, as a product with a triangular matrix, which beats a scan.

    Args:
        block: entries per product, which divides their number; a scan over the blocks' sums joins them. None: all at once.
    """
    count = values.shape[-1]
    size = count if block is None else block
    earlier = jnp.asarray(np.triu(np.ones((size, size), np.float32), 1), values.dtype)
    if size == count:
        return jnp.matmul(values, earlier, precision="highest")  # a GPU would round the factors to ten bits otherwise
    blocks = values.reshape(values.shape[0], -1, size)
    sums = jnp.sum(blocks, -1)
    inside = jnp.matmul(blocks, earlier, precision="highest")
    return (inside + (jnp.cumsum(sums, -1) - sums)[..., None]).reshape(values.shape)
