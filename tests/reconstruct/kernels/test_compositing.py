"""Emission and absorption by compiled loops against plain JAX, and against float64."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reconstruct.kernels import compositing
from reconstruct.numerics.compiling import jit
from reconstruct.numerics.volume import volume_weights
from reconstruct.rendering.compositing import composited
from reconstruct.sampling.samples import RaySamples

pytestmark = pytest.mark.usefixtures("kernels_run")


def packed(counts: list[int], capacity: int, slots: int = 24, seed: int = 0) -> RaySamples:
    """So many samples on each ray; the rest of the list is filled as packing fills it."""
    rng, total = np.random.default_rng(seed), sum(counts)
    ray = np.full(capacity, len(counts) - 1)
    ray[:total] = np.repeat(np.arange(len(counts)), counts)
    slot = np.concatenate([np.arange(count) for count in counts] + [np.full(capacity - total, slots - 1)])
    valid = np.arange(capacity) < total
    t, length = rng.uniform(0.5, 4, capacity), np.where(valid, rng.uniform(0.001, 0.3, capacity), 0)
    arrays = (ray.astype(np.int32), slot.astype(np.int32), t.astype(np.float32), length.astype(np.float32), valid)
    return RaySamples(*map(jnp.asarray, arrays), num_rays=len(counts), max_per_ray=slots)


def both_ways(samples: RaySamples, density: jax.Array, values: tuple[jax.Array, ...]) -> Any:
    """Weights, sums, and the gradients of random cotangents."""
    speed = jnp.linspace(0.9, 1.4, samples.num_rays)
    found, pull = jax.vjp(lambda d, v: composited(d, v, samples, speed), density, values)
    keys = jax.random.split(jax.random.key(3), 2)
    return found, pull(tuple(jax.random.normal(key, one.shape) for key, one in zip(keys, found, strict=True)))


native_of = jit(lambda *arguments: both_ways(*arguments))


@jit
def twin_of(*arguments: Any) -> Any:
    """The same in plain JAX."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compositing, "takes", lambda *_: False)
        return both_ways(*arguments)


def assert_alike(samples: RaySamples, density: Any) -> None:
    count, keys = samples.t.shape[0], jax.random.split(jax.random.key(1), 3)
    values = tuple(jax.random.normal(key, (rows, count)) for key, rows in zip(keys, (3, 1, 7), strict=True))
    density = jnp.asarray(density, jnp.float32)
    ours, theirs = (jax.tree.leaves(run(samples, density, values)) for run in (native_of, twin_of))
    # Sums of float32 in another order: 1e-5 of the largest. In the density's gradient what a sample adds and what it hides
    # cancel: 1e-5 of an interval's length, below which it is with cotangents and values of order one.
    for index, (one, other) in enumerate(zip(ours, theirs, strict=True)):
        largest = float(jnp.max(samples.length if index == 2 else jnp.abs(other), initial=0.0))
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5 * largest + 1e-30)


def densities(count: int) -> np.ndarray:
    """From nearly nothing to opaque."""
    return np.exp(np.random.default_rng(5).uniform(-12, 8, count)).astype(np.float32)


@pytest.mark.parametrize("counts", [[1], [24], [0, 0, 3], [5] * 64, [3] * 65, [0] * 200, [24] * 129, [0, 24, 1] * 70])
def test_weights_sums_and_gradients_are_those_of_the_twin(counts: list[int]) -> None:
    capacity = max(sum(counts) + 7, 16)
    assert_alike(packed(counts, capacity), densities(capacity))


@pytest.mark.parametrize("count", [2**17, pytest.param(2**20, marks=pytest.mark.slow)])
def test_large_batches(count: int) -> None:
    counts = np.random.default_rng(2).integers(0, 17, count // 8).tolist()
    assert_alike(packed(counts, sum(counts) + 5), densities(sum(counts) + 5))


@given(
    counts=st.lists(st.integers(0, 6), min_size=80, max_size=80),
    densities=st.lists(st.sampled_from([0.0, 1e-30, 1e-6, 0.3, 1.0, 40.0, 1e4, 1e30]), min_size=1, max_size=20),
)
def test_worst_cases(counts: list[int], densities: list[float]) -> None:
    assert_alike(packed(counts, 500), np.resize(densities, 500))


def test_entries_that_do_not_count_have_neither_weight_nor_gradient() -> None:
    samples = packed([4, 2], 10)
    samples = replace(samples, valid=samples.valid & (samples.ray == 0))
    found = jax.tree.leaves(native_of(samples, jnp.full(10, 3.0), (jnp.ones((1, 10)),)))
    weights, sums, of_density, of_value = map(np.asarray, found)
    assert not weights[1].any() and not sums[:, 1].any()
    assert weights[0, :4].all() and of_density[:4].all() and of_value[0, :4].all()
    assert not of_density[4:].any() and not of_value[0, 4:].any()


def test_weights_against_double_precision() -> None:
    counts = [24] * 50
    samples, density = packed(counts, 1200), densities(1200)
    speed = jnp.linspace(0.9, 1.4, 50)
    weights = composited(jnp.asarray(density), (jnp.ones((1, 1200)),), samples, speed)[0]
    with jax.enable_x64(True):
        lengths = np.asarray(samples.length, np.float64).reshape(50, 24) * np.asarray(speed, np.float64)[:, None]
        expected = volume_weights(jnp.asarray(density.reshape(50, 24), jnp.float64), jnp.asarray(lengths))
    # a sum of 24 depths of up to 80, each rounded: 24 * 2^-24 * 80 of a weight behind so much; 5e-6 before it
    np.testing.assert_allclose(weights, expected, rtol=1.2e-4, atol=1e-9)
