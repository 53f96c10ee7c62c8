"""Sums along short rows as products with a triangular matrix, which beat a scan."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def sum_before(values: Float[Array, "rows n"], block: int | None = None) -> Float[Array, "rows n"]:
    """Sum of the entries of a row before each one.

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
