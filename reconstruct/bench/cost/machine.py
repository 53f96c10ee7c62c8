"""Upper limits of this machine for the operations of training, to compare kernels with.

All are measured through JAX in single precision, with all cores of the process.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

REPEATS = 5
TABLES = {"in the cache": 2**20, "beside the cache": 2**25}
"""Rows of the tables: as many as the fast preset has, and more than any cache holds."""
ENTRIES = 2**20  # random entries per lookup


@dataclass(frozen=True)
class Limit:
    """One limit of the machine."""

    name: str
    rate: float
    unit: str
    meaning: str


def limits() -> list[Limit]:
    """Measure all limits; takes some seconds."""
    lookups = [rate(name, size) for rate in (lookup_rate, scatter_rate) for name, size in TABLES.items()]
    return [matrix_rate(), narrow_matrix_rate(), stream_rate(), exponential_rate(), *lookups, dispatch_time()]


def seconds_of(function: Callable[..., Any], *arguments: Any, repeats: int = REPEATS) -> float:
    """Fastest of several runs of a compiled function with its arguments in memory."""
    compiled = jax.jit(function).lower(*arguments).compile()
    return fastest(lambda: compiled(*arguments), repeats)


def fastest(call: Callable[[], Any], repeats: int = REPEATS) -> float:
    """Seconds of the fastest of several calls, after one to warm up."""
    jax.block_until_ready(call())
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(call())
        found.append(time.perf_counter() - start)
    return min(found)


def _normal(*shape: int) -> jax.Array:
    return jax.random.normal(jax.random.key(0), shape)


def matrix_rate(size: int = 1024) -> Limit:
    """Product of large square matrices: two operations per multiplication."""
    seconds = seconds_of(jnp.matmul, _normal(size, size), _normal(size, size))
    return Limit("matrix", 2 * size**3 / seconds, "1/s", f"operations of a product of two {size} x {size} matrices")


def narrow_matrix_rate(width: int = 64, columns: int = 16384) -> Limit:
    """Product as narrow as a layer of the fast preset."""
    seconds = seconds_of(jnp.matmul, _normal(width, width), _normal(width, columns))
    meaning = f"operations of a product of {width} x {width} and {width} x {columns}: a layer of the fast preset"
    return Limit("narrow matrix", 2 * width * width * columns / seconds, "1/s", meaning)


def stream_rate(count: int = 2**24) -> Limit:
    """Memory bandwidth: two arrays read and one written, larger than any cache."""
    seconds = seconds_of(lambda a, b: a + 2.5 * b, _normal(count), _normal(count))
    return Limit("stream", 12 * count / seconds, "B/s", f"bytes moved by a + 2.5 b of {count} numbers")


def exponential_rate(count: int = 2**20) -> Limit:
    """Exponentials of numbers in the cache."""
    return Limit("exponential", count / seconds_of(jnp.exp, _normal(count)), "1/s", f"exponentials, {count} at a time")


def _entries(size: int) -> jax.Array:
    return jnp.asarray(np.random.default_rng(0).integers(0, size, ENTRIES), jnp.int32)


def lookup_rate(name: str, size: int) -> Limit:
    """Lookup of single numbers at random rows of a table."""
    seconds = seconds_of(lambda table, index: table.at[index].get(mode="promise_in_bounds"), _normal(size), _entries(size))
    return Limit(f"gather, {name}", ENTRIES / seconds, "1/s", f"numbers looked up at random places of {size}")


def scatter_rate(name: str, size: int) -> Limit:
    """Addition of single numbers at random rows of a table; initialising the table is not counted."""
    add = lambda table, index, values: table.at[index].add(values, mode="promise_in_bounds")  # noqa: E731
    values, index, table = _normal(ENTRIES), _entries(size), jnp.zeros(size)
    seconds = seconds_of(add, table, index, values) - seconds_of(lambda table: table + 0.0, table)
    return Limit(f"scatter, {name}", ENTRIES / max(seconds, 1e-9), "1/s", f"numbers added at random places of {size}")


def dispatch_time() -> Limit:
    """Time to start a program that does almost nothing."""
    one = jnp.zeros(())
    return Limit("start", seconds_of(lambda a: a + 1, one, repeats=200), "s", "time to start a compiled program and wait for it")


def text(found: list[Limit]) -> str:
    """The limits as text, a line each."""
    width = max(len(limit.name) for limit in found)
    return "\n".join(f"{limit.name:<{width}}  {scaled(limit.rate, limit.unit):>14}   {limit.meaning}" for limit in found)


def scaled(rate: float, unit: str) -> str:
    """A rate with a prefix: 93 G/s, 21 GB/s, 14 us."""
    if unit == "s":
        return f"{1e6 * rate:.3g} us"
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rate >= factor:
            return f"{rate / factor:.3g} {prefix}{unit.removeprefix('1')}"
    return f"{rate:.3g} {unit}"
