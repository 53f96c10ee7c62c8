"""Which steps of rays are drawn: those in which the occupancy grid has something to see.

A ray is cut into steps. A step is drawn with a probability that follows what the grid expects it to contribute to the
pixel, and then stands for one over that probability of its length: the optical depth along the ray keeps its expected
value, whatever was drawn (importance sampling; systematic draws, Madow 1949). Work follows what can be seen, not merely
what is occupied.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.volume import sum_before
from koala3d.reconstruct.sampling.occupancy import Occupancy
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


def draw(
    probability: Float[Array, "n steps"], offset: Float[Array, " n"], most: int
) -> tuple[Int[Array, "n most"], Int[Array, " n"]]:
    """Systematic draw: the steps in which `offset` and the running sum of probabilities pass an integer, and how many these are.

    The first so many of a row count. Once in a million draws the sum's rounding passes an integer in a step of no probability.
    """
    passed = barrier(jnp.floor(sum_before(probability, BLOCK) + probability + offset[:, None]))
    integers = jnp.arange(1, most + 1, dtype=passed.dtype)
    step = jax.vmap(lambda row: jnp.searchsorted(row, integers))(passed).astype(jnp.int32)
    return jnp.minimum(step, probability.shape[-1] - 1), jnp.minimum(passed[:, -1], most).astype(jnp.int32)
