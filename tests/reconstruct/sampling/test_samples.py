import jax
import jax.numpy as jnp
import numpy as np

from reconstruct.sampling.samples import RaySamples


def ragged(counts: list[int], capacity: int, slots: int) -> RaySamples:
    """Samples with so many entries per ray, then filling."""
    ray = np.repeat(np.arange(len(counts)), counts)
    slot = np.concatenate([np.arange(c) for c in counts])
    filling = capacity - len(ray)
    pad = lambda a: jnp.asarray(np.concatenate([a, np.full(filling, len(counts) - 1)]), jnp.int32)  # noqa: E731
    valid = jnp.arange(capacity) < len(ray)
    t = jnp.where(valid, jnp.arange(capacity) / capacity, 1.0)
    return RaySamples(pad(ray), jnp.minimum(pad(slot), slots - 1), t, jnp.where(valid, 0.5, 0.0), valid, len(counts), slots)


def test_padded_lays_rays_out_and_packed_undoes_it() -> None:
    samples = ragged([3, 0, 1, 4], capacity=12, slots=4)
    values = jnp.arange(1.0, 13.0)
    expected = np.array([[1, 2, 3, 0], [0, 0, 0, 0], [4, 0, 0, 0], [5, 6, 7, 8]], float)
    np.testing.assert_array_equal(samples.padded(values), expected)
    np.testing.assert_array_equal(samples.packed(samples.padded(values)), [1, 2, 3, 4, 5, 6, 7, 8, 0, 0, 0, 0])
    table = jnp.where(samples.padded(jnp.ones(12)) > 0, jax.random.normal(jax.random.key(0), (4, 4)), 0.0)
    np.testing.assert_array_equal(samples.padded(samples.packed(table)), table)


def test_padding_passes_gradients_to_valid_entries_alone() -> None:
    samples = ragged([2, 1], capacity=5, slots=3)
    gradient = jax.grad(lambda v: jnp.sum(samples.padded(v) * jnp.arange(1.0, 7.0).reshape(2, 3)))(jnp.full(5, jnp.nan))
    np.testing.assert_array_equal(gradient, [1, 2, 4, 0, 0])


def test_from_edges_takes_centres_and_lengths() -> None:
    samples = RaySamples.from_edges(jnp.array([[0.0, 1.0, 3.0], [2.0, 2.0, 5.0]]))
    np.testing.assert_array_equal(samples.padded(samples.t), [[0.5, 2.0], [2.0, 3.5]])
    np.testing.assert_array_equal(samples.padded(samples.length), [[1, 2], [0, 3]])
    np.testing.assert_array_equal(samples.ray, [0, 0, 1, 1])
    assert samples.valid.all()


def test_rows_hold_their_first_samples() -> None:
    t = jnp.arange(6.0).reshape(2, 3) + 1
    samples = RaySamples.in_rows(t, jnp.full((2, 3), 0.5), jnp.array([2, 0]))
    np.testing.assert_array_equal(samples.padded(samples.t), [[1, 2, 0], [0, 0, 0]])
    np.testing.assert_array_equal(samples.length, [0.5, 0.5, 0, 0, 0, 0])
    np.testing.assert_array_equal(samples.ray, [0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(samples.slot, [0, 1, 2, 0, 1, 2])
