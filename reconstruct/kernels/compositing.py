"""Emission and absorption along rays through compiled kernels: weights of packed samples and sums over each ray."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from koala3d.reconstruct.kernels import native

Values = tuple[Float[Array, "_ n"], ...]
Interval = tuple[Any, ...]
"""Of each sample: ray, slot, t, length, valid; and the length of each ray's direction."""


def takes(density: Any, values: Values) -> bool:
    """Whether the kernels are for these arrays."""
    return native.usable(density, *values)


def _call(slots: int, density: Array, values: Values, interval: Interval) -> tuple[Array, Array]:
    rays, channels = interval[-1].shape[0], 2 + sum(value.shape[0] for value in values)
    results = [native.float32(rays, slots), native.float32(channels, rays)]
    weights, sums = native.call("composite", results, *interval, density, *values)
    return weights, sums


_composited = jax.custom_vjp(_call, nondiff_argnums=(0,))


def composited(
    density: Float[Array, " n"], values: Values, interval: Interval, slots: int
) -> tuple[Float[Array, "rays slots"], Float[Array, "channels rays"]]:
    """Weights of samples, and sums over each ray of weights, of weighted t and of weighted values.

    Differentiable to density and values; where samples lie is data.
    """
    return _composited(slots, density, values, interval)


def _forward(slots: int, density: Array, values: Values, interval: Interval) -> tuple[tuple[Array, Array], Any]:
    return _call(slots, density, values, interval), (density, values, interval)


def _backward(slots: int, saved: Any, cotangents: tuple[Array, Array]) -> tuple[Array, Values, Interval]:
    density, values, interval = saved
    shapes = [native.float32(*array.shape) for array in (density, *values)]
    of_density, *of_values = native.call("composite_back", shapes, *interval, density, *values, *cotangents)
    return of_density, tuple(of_values), jax.tree.map(_nothing, interval)


def _nothing(array: Array) -> Any:
    """The gradient of what is data."""
    return jnp.zeros_like(array) if jnp.issubdtype(array.dtype, jnp.inexact) else np.zeros(array.shape, jax.dtypes.float0)


_composited.defvjp(_forward, _backward)
