import jax
import jax.numpy as jnp
import numpy as np

from koala3d.reconstruct.sampling.samples import RaySamples
from tests import drawn

PADDED, PACKED = jax.jit(RaySamples.padded), jax.jit(RaySamples.packed)


def ragged(counts: list[int], capacity: int, slots: int) -> RaySamples:
    """Samples with so many entries per ray, then filling."""
    ray = np.repeat(np.arange(len(counts)), counts)
    slot = np.concatenate([np.arange(c) for c in counts])
    filling = capacity - len(ray)
    pad = lambda a, last: drawn.array(np.concatenate([a, np.full(filling, last)]), np.int32)  # noqa: E731
    valid = np.arange(capacity) < len(ray)
    t = np.where(valid, np.arange(capacity) / capacity, 1.0)
    lists = pad(ray, len(counts) - 1), pad(slot, slots - 1), drawn.array(t), drawn.array(np.where(valid, 0.5, 0.0))
    return RaySamples(*lists, drawn.array(valid, bool), len(counts), slots)


def test_padded_lays_rays_out_and_packed_undoes_it() -> None:
    samples = ragged([3, 0, 1, 4], capacity=12, slots=4)
    values = np.arange(1.0, 13.0, dtype=np.float32)
    expected = np.array([[1, 2, 3, 0], [0, 0, 0, 0], [4, 0, 0, 0], [5, 6, 7, 8]], float)
    np.testing.assert_array_equal(PADDED(samples, values), expected)
    np.testing.assert_array_equal(PACKED(samples, PADDED(samples, values)), [1, 2, 3, 4, 5, 6, 7, 8, 0, 0, 0, 0])
    table = np.where(expected > 0, drawn.normal(4, 4), 0.0).astype(np.float32)
    np.testing.assert_array_equal(PADDED(samples, PACKED(samples, table)), table)


def test_padding_passes_gradients_to_valid_entries_alone() -> None:
    samples = ragged([2, 1], capacity=5, slots=3)
    total = lambda v: jnp.sum(samples.padded(v) * jnp.arange(1.0, 7.0).reshape(2, 3))  # noqa: E731
    np.testing.assert_array_equal(jax.jit(jax.grad(total))(np.full(5, np.nan, np.float32)), [1, 2, 4, 0, 0])


def test_from_edges_takes_centres_and_lengths() -> None:
    samples = jax.jit(RaySamples.from_edges)(np.float32([[0.0, 1.0, 3.0], [2.0, 2.0, 5.0]]))
    np.testing.assert_array_equal(PADDED(samples, samples.t), [[0.5, 2.0], [2.0, 3.5]])
    np.testing.assert_array_equal(PADDED(samples, samples.length), [[1, 2], [0, 3]])
    np.testing.assert_array_equal(samples.ray, [0, 0, 1, 1])
    assert np.all(samples.valid)


def test_rows_hold_their_first_samples() -> None:
    t = np.arange(1, 7, dtype=np.float32).reshape(2, 3)
    samples = jax.jit(RaySamples.in_rows)(t, np.full((2, 3), 0.5, np.float32), np.int32([2, 0]))
    np.testing.assert_array_equal(PADDED(samples, samples.t), [[1, 2, 0], [0, 0, 0]])
    np.testing.assert_array_equal(samples.length, [0.5, 0.5, 0, 0, 0, 0])
    np.testing.assert_array_equal(samples.ray, [0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(samples.slot, [0, 1, 2, 0, 1, 2])
