"""Emission and absorption along rays through compiled kernels: weights of packed samples and sums over each ray."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from koala3d.reconstruct.kernels import native

Values = tuple[Float[Array, "_ n"], ...]
Places = tuple[Any, ...]
"""Of each sample: ray, slot, t, valid."""


def takes(depth: Any, values: Values) -> bool:
    """Whether the kernels are for these arrays."""
    return native.usable(depth, *values)


def _call(table: tuple[int, int], depth: Array, values: Values, places: Places) -> tuple[Array, Array]:
    results = [native.float32(*table), native.float32(2 + sum(value.shape[0] for value in values), table[0])]
    weights, sums = native.call("composite", results, *places, depth, *values)
    return weights, sums


_composited = jax.custom_vjp(_call, nondiff_argnums=(0,))


def composited(
    depth: Float[Array, " n"], values: Values, places: Places, table: tuple[int, int]
) -> tuple[Float[Array, "rays slots"], Float[Array, "channels rays"]]:
    """Weights of samples, and sums over each ray of weights, of weighted t and of weighted values.

    Differentiable to optical depth and values; where samples lie is data.

    Args:
        table: number of rays and of slots.
    """
    return _composited(table, depth, values, places)


def _forward(table: tuple[int, int], depth: Array, values: Values, places: Places) -> tuple[tuple[Array, Array], Any]:
    return _call(table, depth, values, places), (depth, values, places)


def _backward(table: tuple[int, int], saved: Any, cotangents: tuple[Array, Array]) -> tuple[Array, Values, Places]:
    depth, values, places = saved
    shapes = [native.float32(*array.shape) for array in (depth, *values)]
    of_depth, *of_values = native.call("composite_back", shapes, *places, depth, *values, *cotangents)
    return of_depth, tuple(of_values), jax.tree.map(_nothing, places)


def _nothing(array: Array) -> Any:
    """The gradient of what is data."""
    return jnp.zeros_like(array) if jnp.issubdtype(array.dtype, jnp.inexact) else np.zeros(array.shape, jax.dtypes.float0)


_composited.defvjp(_forward, _backward)
