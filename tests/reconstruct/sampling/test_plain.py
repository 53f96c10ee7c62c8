"""`sample` and `pack`, in plain JAX and as kernels, against what is computed in float64."""

from types import ModuleType

import jax
import numpy as np
import pytest

from koala3d.reconstruct.numerics.compiling import jit
from koala3d.reconstruct.sampling import compiled, plain
from koala3d.reconstruct.sampling.drawing import LEAST_IMPORTANCE
from koala3d.reconstruct.sampling.samples import Rows
from tests import drawn
from tests.reconstruct.sampling.columns import LENGTH, NEAREST, Columns

PACK = {way: jit(way.pack, static_argnames="capacity") for way in (plain, compiled)}


@pytest.fixture(params=[plain, compiled], ids=["plain", "compiled"])
def way(request: pytest.FixtureRequest) -> ModuleType:
    if request.param is compiled:
        request.getfixturevalue("kernels_run")
    return request.param


def probabilities(depth: np.ndarray, wanted: int) -> np.ndarray:
    """That each step is drawn, in float64."""
    before = np.cumsum(depth, -1) - depth
    importance = np.where(depth > 0, depth * np.exp(-before) + LEAST_IMPORTANCE, 0.0)
    factor = wanted / np.maximum(importance.sum(-1, keepdims=True), 1e-9)
    for _ in range(3):
        certain = importance * factor >= 1
        rest = np.where(certain, 0, importance).sum(-1, keepdims=True)
        factor = np.maximum(factor, (wanted - certain.sum(-1, keepdims=True)) / np.maximum(rest, 1e-9))
    return np.minimum(importance * factor, 1)


def test_draws_are_systematic_and_keep_the_optical_depth(way: ModuleType, some_depths) -> None:
    """Over evenly spread offsets each step is drawn as often as its probability says and stands for its length over it."""
    depth, offsets, wanted = some_depths(16, 96).astype(np.float16), (np.arange(500) + 0.5) / 500, 16
    expected = probabilities(depth.astype(np.float64), wanted)
    rows = Columns.of(depth, 500).sample(way, np.full(8000, 0.5), np.tile(offsets, 16), wanted + 1)
    t, length, count = (np.asarray(one, np.float64) for one in rows)
    there = np.arange(wanted + 1) < count[:, None]
    ray, step = np.nonzero(there)[0], np.floor((t[there] - NEAREST) / LENGTH * 96).astype(int)
    drawn_steps = np.zeros((8000, 96))
    np.add.at(drawn_steps, (ray, step), 1)
    assert drawn_steps.max() == 1, "each at most once"
    # an offset grid of 1/500 and float32 sums up to 16 with 2e-6 of rounding
    np.testing.assert_allclose(drawn_steps.reshape(16, 500, 96).mean(1), expected, atol=3 / 500)
    assert (np.abs(count.reshape(16, 500) - expected.sum(-1, keepdims=True)) <= 1).all()
    np.testing.assert_allclose(length[there] * expected[ray // 500, step], LENGTH / 96, rtol=1e-4)  # float32 sums over 96 steps
    assert (t[~there] == 1).all() and (length[~there] == 0).all()
    density = np.random.default_rng(4).uniform(0, 3, 96)
    met = np.bincount(ray, density[step] * length[there], 8000).reshape(16, 500).mean(-1)
    # a step of probability 0.05 is met by 25 of 500 offsets +-1
    np.testing.assert_allclose(met, ((depth > 0) * density).sum(-1) * LENGTH / 96, rtol=0.02)


def some_rows(share: float) -> Rows:
    """Of 60 rays with room for 7 samples each; so many have any."""
    rng = np.random.default_rng(2)
    count = np.where(rng.random(60) < share, rng.integers(1, 8, 60), 0).astype(np.int32)
    there = np.arange(7) < count[:, None]
    t, length = rng.uniform(2, 3, (2, 60, 7))
    return Rows(drawn.array(np.where(there, t, 1)), drawn.array(np.where(there, length, 0)), drawn.array(count, np.int32))


@pytest.mark.parametrize(("share", "capacity"), [(0.6, 500), (0.6, 90), (0.3, 120), (0.9, 120), (0, 9)])
def test_packed_rows_equal_a_loop(way: ModuleType, share: float, capacity: int) -> None:
    rows = some_rows(share)
    used, samples = PACK[way](rows, capacity=capacity)
    t, length, count = (np.asarray(one) for one in rows)
    expected, expected_used, end = [], np.zeros(60, bool), 0
    for ray in range(60):
        end += count[ray]
        expected_used[ray] = count[ray] > 0 and end <= capacity
        expected += [(ray, slot, t[ray, slot], length[ray, slot]) for slot in range(count[ray] if expected_used[ray] else 0)]
    assert (end > capacity) == (capacity in (90, 120) and share > 0.5), "two of the lists overflow"
    np.testing.assert_array_equal(used, expected_used)
    valid = np.asarray(samples.valid)
    ours = np.stack([np.asarray(one, np.float64) for one in (samples.ray, samples.slot, samples.t, samples.length)], -1)
    np.testing.assert_array_equal(ours[valid], np.array(expected, np.float64).reshape(-1, 4))
    assert samples.ray.shape == (capacity,) and (np.diff(samples.ray) >= 0).all()
    assert (ours[:, 0] < 60).all() and (ours[:, 1] < 7).all() and (ours >= 0).all()
    np.testing.assert_array_equal(ours[~valid, 2:], np.tile([1.0, 0.0], ((~valid).sum(), 1)))


@pytest.mark.usefixtures("kernels_run")
@pytest.mark.parametrize(("share", "capacity"), [(0.6, 90), (0.9, 120)])
def test_both_pack_the_same(share: float, capacity: int) -> None:
    """What is not valid included."""
    ours, theirs = (jax.tree.leaves(PACK[way](some_rows(share), capacity=capacity)) for way in (compiled, plain))
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("wanted", [10, 60])
def test_the_first_rows_with_samples(wanted: int) -> None:
    rows = some_rows(0.6)
    order, first = rows.first_filled(wanted)
    there = np.flatnonzero(rows.filled)[:wanted]
    assert (len(there) < wanted) == (wanted == 60)
    np.testing.assert_array_equal(order[: len(there)], there)
    for one, whole in zip(first, rows, strict=True):
        np.testing.assert_array_equal(one[: len(there)], np.asarray(whole)[there])
    assert not np.asarray(first.filled)[len(there) :].any()
