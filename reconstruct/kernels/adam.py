"""A step of Adam over one large array through a compiled kernel."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from koala3d.reconstruct.kernels import native

WORTH_IT = 16384
"""Numbers below which starting a kernel takes longer than its work."""


def takes(parameter: Any) -> bool:
    """Whether the kernel is for this array."""
    return parameter.size >= WORTH_IT and native.usable(parameter)


def descended(
    gradient: Float[Array, "*shape"],
    parameter: Float[Array, "*shape"],
    mean: Float[Array, "*shape"],
    square: Float[Array, "*shape"],
    *,
    decays: tuple[float, float],
    smallest: float,
    shrinks: float,
    count: Any,
    rate: Float[Array, ""],
    finite: Bool[Array, ""],
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Parameter and moments after a step (Kingma and Ba 2015, algorithm 1); as before where the gradient is not `finite`.

    The new arrays take the memory of the old ones where nothing else needs those.

    Args:
        decays: of the mean and of the mean square, beta_1 and beta_2.
        smallest: epsilon, added to the root of the mean square.
        shrinks: weight decay: this times the parameter is added to its gradient.
        count: steps up to this one, at least 1.
    """
    corrections = [1 - decay ** jnp.asarray(count, jnp.float32) for decay in decays]
    numbers = jnp.stack([jnp.asarray(v, jnp.float32) for v in (*decays, *corrections, smallest, rate, finite, shrinks)])
    like = [native.float32(*parameter.shape)] * 3
    new = native.call("descend", like, gradient, parameter, mean, square, numbers, in_place={1: 0, 2: 1, 3: 2})
    return new[0], new[1], new[2]
