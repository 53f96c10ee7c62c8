"""The sum of an array's squares, through a compiled kernel where the array is large."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from koala3d.reconstruct.kernels import native

CHUNK = 32768
"""Numbers of a chunk: they fit into the second-level cache."""


def sum_of_squares(array: Float[Array, "*shape"]) -> Float[Array, ""]:
    """Sum of the squares of all numbers."""
    if array.size < 2 * CHUNK or not native.usable(array):
        return jnp.sum(jnp.square(array))
    return native.call("squares", [native.float32(), native.float32(-(-array.size // CHUNK))], array)[0]
