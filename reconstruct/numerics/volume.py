"""Emission and absorption along a ray: from densities to optical depths, and from those to weights."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

OPAQUE = 80.0
"""Optical depth at which an interval counts as opaque: exp(-80) is 0 beside anything that float32 can show."""

SPENT = float(-np.log(1e-3))
"""Optical depth behind which nothing is looked at: less than a thousandth of the light would arrive."""
SURFACE = 1 / 64
"""What a rise of the density is multiplied by: the surface of a solid is where the density is ln 2 / SURFACE [scene unit]."""


def optical_depth(
    density: Float[Array, "*n"], before: Float[Array, "*n"], lengths: Float[Array, "*n"], *, solid: bool
) -> Float[Array, "*n"]:
    """How much light is lost on the way to each sample of a ray, as an exponent in [0, OPAQUE].

    In a fog light is lost along the way, d = density length. On a solid it is lost where the density rises,

        d = SURFACE max(0, density - density of the sample in front),

    so that exp(-SURFACE density) of the densest sample is left, however long the way was: a ray that touches a surface loses as
    much as one that meets it head on. In a fog the former goes a long way through the thin outer parts; where silhouettes are
    right, the surface then looks too deep. The weights of NeuS (Wang et al. 2021, equation 13) are these for a logistic function
    of a distance.

    Args:
        density: at least 0 [1 / scene unit].
        before: that of the sample in front; 0 in front of the first.
        lengths: of the samples' intervals, at least 0 [scene unit]; nothing is lost at samples without length.
        solid: whether light is lost where the density rises.
    """
    if not solid:
        return jnp.minimum(density * lengths, OPAQUE)
    return jnp.where(lengths > 0, jnp.minimum(SURFACE * jnp.maximum(density - before, 0.0), OPAQUE), 0.0)


def optical_depth_in_rows(
    density: Float[Array, "rays n"], last: Float[Array, " rays"], lengths: Float[Array, "rays n"], *, solid: bool
) -> Float[Array, "rays n"]:
    """`optical_depth` of consecutive samples, a row for each ray. `last`: density in front of the first of each row."""
    before = jnp.concatenate([last[:, None], density[:, :-1]], -1)
    return optical_depth(density, before, lengths, solid=solid)


def volume_weights(depth: Float[Array, "rays samples"]) -> Float[Array, "rays samples"]:
    """Share of a ray's colour that each interval contributes.

    Emission and absorption (NeRF, Mildenhall et al. 2020, equation 3):

        weights[i] = (1 - exp(-d[i])) exp(-sum(d[:i])).

    The second factor is a sum in the exponent, not a product of (1 - alpha): equal in exact arithmetic, but it keeps the
    faint light that float32 loses once alpha rounds to 1.

    Args:
        depth: optical depth d of each interval, at least 0: see `optical_depth`.

    Returns:
        Weights in [0, 1], summing to at most 1; one minus the sum is what the background receives.
    """
    depth = jnp.minimum(depth, OPAQUE)
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
