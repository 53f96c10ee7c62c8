"""Samples along rays where the occupancy grid has something to see, packed without gaps.

A ray is cut into steps. A step is drawn with a probability that follows what the grid expects it to contribute to the
pixel, and then stands for one over that probability of its length: the optical depth along the ray keeps its expected
value, whatever was drawn (importance sampling; systematic draws, Madow 1949). Work follows what can be seen, not merely
what is occupied.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.volume import sum_before
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.samples import RaySamples
from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Space

BLOCK = 32
"""Steps whose probabilities are summed by one product; the number of steps is a multiple of it."""
LEAST_IMPORTANCE = 0.02
"""Importance of an occupied step that the grid believes hidden; that of an opaque, visible one is 1."""


def expected_depth(
    occupancy: Occupancy, rays: Rays, steps: Steps, jitter: Float[Array, " n"], space: Space
) -> Float[Array, "n steps"]:
    """Optical depth that the grid expects in each step of each ray; zero in empty cells."""
    t = steps.at(jnp.arange(steps.count, dtype=jnp.float32) + jitter[:, None])
    x, y, z = (rays.origins[:, i, None] + t * rays.directions[:, i, None] for i in range(3))
    x, y, z = space.mapped_coordinates(x, y, z)
    depth = occupancy.depth.at[occupancy.cell(x, y, z)].get(mode="promise_in_bounds").astype(jnp.float32)
    counts = (steps.front, steps.inside, steps.behind)
    has_length = (steps.enter > steps.near, steps.leave > steps.enter, steps.far > steps.leave)
    parts = [jnp.broadcast_to(part[:, None], (depth.shape[0], count)) for part, count in zip(has_length, counts, strict=True)]
    return jnp.where(jnp.concatenate(parts, -1), depth, 0.0)  # a ray that misses has no steps inside


def draw_probability(depth: Float[Array, "n steps"], wanted: int) -> Float[Array, "n steps"]:
    """Probability that each step is drawn: at most 1, zero where the depth is, `wanted` in all where so many are occupied."""
    importance = depth * jnp.exp(-sum_before(depth, BLOCK)) + LEAST_IMPORTANCE
    importance = barrier(jnp.where(depth > 0, importance, 0.0))
    factor = wanted / jnp.maximum(jnp.sum(importance, -1, keepdims=True), 1e-9)
    for _ in range(3):  # what is certain already leaves its share to the others
        certain = importance * factor >= 1
        room = wanted - jnp.sum(certain, -1, keepdims=True)
        rest = jnp.sum(jnp.where(certain, 0.0, importance), -1, keepdims=True)
        factor = jnp.maximum(factor, room / jnp.maximum(rest, 1e-9))
    return jnp.minimum(importance * factor, 1.0)


def draw(probability: Float[Array, "n steps"], offset: Float[Array, " n"]) -> UInt32[Array, "n words"]:
    """Systematic draw: one bit per step, set where the running sum of probabilities passes `offset` plus an integer."""
    after = sum_before(probability, BLOCK) + probability
    passed = jnp.floor(after + offset[:, None])
    passed_before = jnp.pad(passed[:, :-1], ((0, 0), (1, 0)))
    return _as_bits((passed > passed_before) & (probability > 0))


def _as_bits(flags: Bool[Array, "rays steps"]) -> UInt32[Array, "rays words"]:
    """Booleans as bits, 32 to a word, the first the lowest; their number is a multiple of 32."""
    words = flags.reshape(flags.shape[0], -1, 32).astype(jnp.uint32) << jnp.arange(32, dtype=jnp.uint32)
    return jnp.sum(words, -1, dtype=jnp.uint32)


def select_bit(words: UInt32[Array, "n words"], rank: Int[Array, " n"]) -> Int[Array, " n"]:
    """Position of the set bit of given rank (0 is the first) in rows of words; halving by population counts."""
    counts = jax.lax.population_count(words).astype(jnp.int32)
    before = jnp.cumsum(counts, -1) - counts
    word = jnp.sum((rank[:, None] >= before + counts).astype(jnp.int32), -1)
    word = jnp.minimum(word, words.shape[-1] - 1)
    rest = rank - jnp.take_along_axis(before, word[:, None], -1)[:, 0]
    bits = jnp.take_along_axis(words, word[:, None], -1)[:, 0]
    position = jnp.zeros_like(rank)
    for width in (16, 8, 4, 2, 1):
        low = jax.lax.population_count(bits & jnp.uint32((1 << width) - 1)).astype(jnp.int32)
        beyond = rest >= low
        rest = jnp.where(beyond, rest - low, rest)
        bits = jnp.where(beyond, bits >> jnp.uint32(width), bits)
        position = position + jnp.where(beyond, width, 0)
    return word * 32 + position


def packed_samples(
    words: UInt32[Array, "rays words"],
    probability: Float[Array, "rays steps"],
    steps: Steps,
    jitter: Float[Array, " rays"],
    *,
    capacity: int,
    max_per_ray: int,
) -> tuple[RaySamples, Bool[Array, " rays"]]:
    """The drawn steps of all rays in one list of `capacity` entries, each standing for its length over its probability.

    Returns:
        The samples, and which rays found room for all of theirs: the others take no part.
    """
    kept = jnp.minimum(jnp.sum(jax.lax.population_count(words).astype(jnp.int32), -1), max_per_ray)
    end = jnp.cumsum(kept)
    fits = end <= capacity
    entry = jnp.arange(capacity, dtype=jnp.int32)
    ray = jnp.searchsorted(end, entry, side="right").astype(jnp.int32)
    valid = entry < end[-1]
    ray = jnp.minimum(ray, words.shape[0] - 1)
    get = lambda a: a.at[ray].get(mode="promise_in_bounds")  # noqa: E731
    valid = valid & get(fits)
    slot = jnp.clip(entry - (get(end) - get(kept)), 0, max_per_ray - 1)
    step = select_bit(get(words), jnp.where(valid, slot, 0))
    share = probability.at[ray, jnp.minimum(step, probability.shape[1] - 1)].get(mode="promise_in_bounds")
    step = step.astype(jnp.float32)
    length = (steps.at(step + 1, ray) - steps.at(step, ray)) / jnp.maximum(share, 1e-6)
    t = steps.at(step + get(jitter), ray)
    samples = RaySamples(ray, slot, jnp.where(valid, t, 1.0), jnp.where(valid, length, 0.0), valid, words.shape[0], max_per_ray)
    return samples, fits
