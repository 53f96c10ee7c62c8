"""What changes while training goes on, as functions of progress in [0, 1]."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def learning_rate(progress: Float[Array, ""], *, rate: float, final_rate: float, warmup: float) -> Float[Array, ""]:
    """Log-linear from `rate` to `final_rate`, rising log-linearly from 1e-8 of it over the share `warmup`."""
    decayed = jnp.exp(jnp.log(rate) + progress * (jnp.log(final_rate) - jnp.log(rate)))
    rise = jnp.clip(progress / warmup, 0, 1) if warmup > 0 else jnp.ones(())
    return decayed * jnp.exp((1 - rise) * jnp.log(1e-8))


RISE = 0.1
"""Share of the training over which a late loss comes to its weight."""


def late(progress: Float[Array, ""], *, start: float) -> Float[Array, ""]:
    """Factor on a loss that begins at `start`: zero before, then linear to one over the share `RISE`; one throughout from 0."""
    return jnp.clip((progress - start) / RISE, 0, 1) if start > 0 else jnp.ones(())


def between(progress: Float[Array, ""], *, first: float, last: float, over: tuple[float, float]) -> Float[Array, ""]:
    """A weight that goes linearly from `first` to `last` between two shares of the training."""
    return first + (last - first) * jnp.clip((progress - over[0]) / (over[1] - over[0]), 0, 1)


def encoding_blur(progress: Float[Array, ""], *, first: float, last: float, until: float) -> Float[Array, ""]:
    """Width of the encoding's blur: log-linear from `first` to `last` over the share `until` of the training; 0 is no blur."""
    if first == 0 or last == 0:
        return jnp.zeros(())
    share = jnp.clip(progress / until, 0, 1)
    return jnp.exp(jnp.log(first) + share * (jnp.log(last) - jnp.log(first)))
