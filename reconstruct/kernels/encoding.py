"""The lattice encoding through compiled kernels: values, derivatives to the position, and the gradient to the table.

Rows and weights are found anew on the way back: the search takes a quarter of the time of a pass and would otherwise leave half
a kilobyte per point to be written and read.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.kernels import native

Share = Float[Array, "levels n"] | Float[Array, "levels 1"]


def encode(
    table: Float[Array, "features rows"],
    points: Float[Array, "3 n"],
    share: Share,
    units: Float[np.ndarray, " levels"],
    sizes: Int[np.ndarray, "2 levels"],
    *,
    with_slopes: bool,
    onto: Float[Array, "features rows"] | None = None,
) -> tuple[Float[Array, "channels n"], Float[Array, "channels 3 n"] | None]:
    """Features of points and, with slopes, their derivatives; differentiable to the table, everything else is data.

    Args:
        onto: as of `HashedGrid`.
        share: how much each level weighs, for every point or for all.
        units: lattice units per unit of the points.
        sizes: logarithm of each level's rows, to base 2, and its first row.
    """
    place = (points, jnp.asarray(share), np.asarray(units, np.float32), np.asarray(sizes, np.int32))
    values = _encode(table, place, onto, with_slopes)
    channels, count = table.shape[0] * len(units), points.shape[1]
    flat = values[0].reshape(channels, count)
    return flat, values[1].reshape(channels, 3, count) if with_slopes else None


def _shapes(features: int, levels: int, count: int, with_slopes: bool) -> list[jax.ShapeDtypeStruct]:
    shapes = [native.float32(features, levels, count)]
    return [*shapes, native.float32(features, levels, 3, count)] if with_slopes else shapes


def _call_encode(table: Array, place: tuple[Any, ...], with_slopes: bool) -> tuple[Array, ...]:
    shapes = _shapes(table.shape[0], place[2].shape[0], place[0].shape[1], with_slopes)
    return native.call("encode", shapes, *place, table)


@partial(jax.custom_vjp, nondiff_argnums=(3,))
def _encode(table: Array, place: tuple[Any, ...], onto: Array | None, with_slopes: bool) -> tuple[Array, ...]:
    return _call_encode(table, place, with_slopes)


def _forward(table: Array, place: tuple[Any, ...], onto: Array | None, with_slopes: bool) -> tuple[tuple[Array, ...], Any]:
    return _call_encode(table, place, with_slopes), (place, onto, table.shape)


def _backward(with_slopes: bool, saved: Any, cotangents: tuple[Array, ...]) -> tuple[Array, None, None]:
    place, onto, shape = saved
    arguments = (*place, *cotangents)
    if onto is None:
        (gradient,) = native.call("scatter", [native.float32(*shape)], *arguments)
    else:
        (gradient,) = native.call("scatter_onto", [native.float32(*shape)], *arguments, onto, in_place={len(arguments): 0})
    return gradient, None, None


_encode.defvjp(_forward, _backward)
