"""Positional encoding of view directions (NeRF, Mildenhall et al. 2020, equation 4, with the direction itself in front)."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def view_channels(degree: int) -> int:
    """Number of outputs of `view_encoding`."""
    return 3 + 6 * degree


def view_encoding(directions: Float[Array, "3 n"], degree: int) -> Float[Array, "channels n"]:
    """Unit directions, then sin(2^i d) and cos(2^i d) for i = 0..degree - 1."""
    angles = [directions * 2.0**i for i in range(degree)]
    return jnp.concatenate([directions, *(jnp.sin(angle) for angle in angles), *(jnp.cos(angle) for angle in angles)])
