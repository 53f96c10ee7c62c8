"""Emission and absorption by compiled loops against plain JAX, and against float64."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koala3d.reconstruct.kernels import compositing
from koala3d.reconstruct.numerics.compiling import jit
from koala3d.reconstruct.numerics.volume import volume_weights
from koala3d.reconstruct.rendering.compositing import composited
from koala3d.reconstruct.sampling.samples import RaySamples
from tests import drawn

pytestmark = pytest.mark.usefixtures("kernels_run")

RAYS, ROOM, SLOTS = 2048, 2**15, 24
"""The twin is compiled for so many rays and entries and for no other number: fewer of them are the first of these."""


def packed(counts: list[int], capacity: int) -> RaySamples:
    """So many samples on each ray; the rest of the list is filled as packing fills it."""
    rng, total = np.random.default_rng(0), sum(counts)
    ray = np.full(capacity, len(counts) - 1)
    ray[:total] = np.repeat(np.arange(len(counts)), counts)
    slot = np.concatenate([*(np.arange(count) for count in counts), np.full(capacity - total, SLOTS - 1)])
    valid = np.arange(capacity) < total
    room = max(ROOM, capacity)
    t, length = rng.uniform(0.5, 4, room)[:capacity], np.where(valid, rng.uniform(0.001, 0.3, room)[:capacity], 0)
    arrays = (ray.astype(np.int32), slot.astype(np.int32), t.astype(np.float32), length.astype(np.float32), valid)
    return RaySamples(*map(jax.device_put, arrays), num_rays=len(counts), max_per_ray=SLOTS)


def both_ways(samples: RaySamples, depth: jax.Array, values: tuple[jax.Array, ...], bars: Any) -> Any:
    """Weights, sums, and the gradients of cotangents."""
    found, pull = jax.vjp(lambda d, v: composited(d, v, samples), depth, values)
    return found, pull(bars)


native_of = jit(lambda *arguments: both_ways(*arguments))


@jit
def twin_of(*arguments: Any) -> Any:
    """The same in plain JAX."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compositing, "takes", lambda *_: False)
        return both_ways(*arguments)


def given_to(samples: RaySamples, depth: np.ndarray, rays: int, room: int) -> tuple[Any, ...]:
    """Arguments of both, the first of what there is for `rays` rays and `room` entries."""
    count = samples.t.shape[0]
    values = tuple(np.asarray(drawn.normal(rows, room, seed=rows))[:, :count] for rows in (3, 1, 7))
    weights, sums = drawn.normal(rays, SLOTS, seed=4), drawn.normal(13, rays, seed=5)
    bars = np.asarray(weights)[: samples.num_rays], np.asarray(sums)[:, : samples.num_rays]
    return samples, np.asarray(depth, np.float32)[:count], values, bars


def assert_alike(counts: list[int], capacity: int, depth: np.ndarray) -> None:
    rays, room = max(RAYS, len(counts)), max(ROOM, capacity)
    samples, more = packed(counts, capacity), packed(counts + [0] * (rays - len(counts)), room)
    ours = native_of(*given_to(samples, depth, rays, room))
    (weights, sums), (of_depth, of_values) = jax.tree.map(np.asarray, twin_of(*given_to(more, depth, rays, room)))
    theirs = weights[: len(counts)], sums[:, : len(counts)], of_depth[:capacity], *(one[:, :capacity] for one in of_values)
    # Sums of float32 in another order: 1e-5 of the largest. In the depth's gradient what a sample adds and what it hides cancel:
    # 1e-5, with cotangents and values of order one.
    for index, (one, other) in enumerate(zip(jax.tree.leaves(ours), theirs, strict=True)):
        largest = 1.0 if index == 2 else float(np.max(np.abs(other), initial=0.0))
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5 * largest + 1e-30)


def depths(count: int) -> np.ndarray:
    """From nearly nothing to opaque."""
    return np.exp(np.random.default_rng(5).uniform(-14, 6, count)).astype(np.float32)


@pytest.mark.parametrize("counts", [[1], [24], [0, 0, 3], [5] * 64, [3] * 65, [0] * 200, [24] * 129, [0, 24, 1] * 70])
def test_weights_sums_and_gradients_are_those_of_the_twin(counts: list[int]) -> None:
    assert_alike(counts, max(sum(counts) + 7, 16), depths(ROOM))


@pytest.mark.parametrize("count", [2**14, *(pytest.param(n, marks=pytest.mark.slow) for n in (2**17, 2**20))])
def test_large_batches(count: int) -> None:
    counts = np.random.default_rng(2).integers(0, 17, count // 8).tolist()
    assert_alike(counts, sum(counts) + 5, depths(max(ROOM, sum(counts) + 5)))


@given(
    counts=st.lists(st.integers(0, 6), min_size=80, max_size=80),
    depths=st.lists(st.sampled_from([0.0, 1e-30, 1e-6, 0.3, 1.0, 40.0, 1e4, 1e30]), min_size=1, max_size=20),
)
def test_worst_cases(counts: list[int], depths: list[float]) -> None:
    assert_alike(counts, 500, np.resize(depths, ROOM))


def test_entries_that_do_not_count_have_neither_weight_nor_gradient() -> None:
    samples, depth, values, (weights, sums) = given_to(packed([4, 2], 10), depths(10), 2, 10)
    samples = replace(samples, valid=drawn.array(np.asarray(samples.valid) & (np.asarray(samples.ray) == 0), bool))
    found = jax.tree.leaves(native_of(samples, depth, values, (weights, sums)))
    weights, sums, of_depth, of_value = map(np.asarray, found[:4])
    assert not weights[1].any() and not sums[:, 1].any()
    assert weights[0, :4].all() and of_depth[:4].all() and of_value[0, :4].all()
    assert not of_depth[4:].any() and not of_value[0, 4:].any()


def test_weights_against_double_precision() -> None:
    samples, depth, values, bars = given_to(packed([24] * 50, 1200), depths(1200), 50, 1200)
    (weights, _), _ = native_of(samples, depth, values, bars)
    with jax.enable_x64(True):
        expected = jit(volume_weights)(depth.reshape(50, 24).astype(np.float64))
        assert expected.dtype == jnp.float64
    # a sum of 24 depths of up to 80, each rounded: 24 * 2^-24 * 80 of a weight behind so much; 5e-6 before it
    np.testing.assert_allclose(weights, expected, rtol=1.2e-4, atol=1e-9)
