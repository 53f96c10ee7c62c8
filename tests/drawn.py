"""Arrays and parameters made by NumPy: JAX compiles a program for each shape that it draws, fills or converts."""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np

Tree = TypeVar("Tree")
MEASURED = ("towards",)


def array(values: Any, kind: type = np.float32) -> jax.Array:
    """Of single precision, if no other type is wanted."""
    return jax.device_put(np.asarray(values, kind))


def uniform(*shape: int, low: float = 0.0, high: float = 1.0, seed: int = 0) -> jax.Array:
    """Evenly between two numbers."""
    return array(np.random.default_rng(seed).uniform(low, high, shape))


def normal(*shape: int, seed: int = 0) -> jax.Array:
    """Of mean 0 and variance 1."""
    return array(np.random.default_rng(seed).normal(size=shape))


def directions(count: int, seed: int = 0) -> jax.Array:
    """(3, count) of unit length."""
    vectors = np.random.default_rng(seed).normal(size=(3, count))
    return array(vectors / np.linalg.norm(vectors, axis=0))


def filled(make: Callable[[], Tree], seed: int = 0) -> Tree:
    """What `make` returns, with its arrays drawn: matrices by He's rule, vectors small, single numbers zero.

    What would be measured on a scene (`MEASURED`) is zero.
    """
    rng = np.random.default_rng(seed)

    def draw(path: tuple[Any, ...], like: jax.ShapeDtypeStruct) -> jax.Array:
        scale = (0.0, 0.1, (2 / like.shape[-1]) ** 0.5 if like.shape else 0)[min(len(like.shape), 2)]
        values = scale * rng.normal(size=like.shape)
        return array(0 * values if getattr(path[-1], "name", "") in MEASURED else values, like.dtype)

    return jax.tree.map_with_path(draw, eqx.filter_eval_shape(make))
