"""From rays to a list of samples in plain JAX: `sample` marches and draws, `pack` leaves no gaps; `compiled` has them too."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.sampling.drawing import draw, draw_probability, expected_depth
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.samples import RaySamples, Rows
from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Space


def sample(
    occupancy: Occupancy,
    rays: Rays,
    steps: Steps,
    jitter: Float[Array, " rays"],
    offset: Float[Array, " rays"],
    space: Space,
    *,
    max_per_ray: int,
    enough: Int[Array, " 2"] | None = None,
) -> Rows:
    """The drawn steps of each ray, each standing for its length over its probability; `max_per_ray - 1` are expected.

    Args:
        jitter: where in their steps a ray's samples lie, 0 to 1.
        offset: where in the sum of probabilities a ray's draw begins, 0 to 1.
        enough: rays with samples, and samples, that are wanted: once the rays before have so many, the others may be left without
            any.
    """
    depth = barrier(expected_depth(occupancy, rays, steps, jitter, space))
    probability = barrier(draw_probability(depth, max_per_ray - 1))
    step, count = barrier(draw(probability, offset, max_per_ray))
    share, u = jnp.take_along_axis(probability, step, -1), step.astype(jnp.float32)
    is_drawn = jnp.arange(max_per_ray) < count[:, None]
    t = jnp.where(is_drawn, steps.at(u + jitter[:, None]), 1.0)
    length = jnp.where(is_drawn & (share > 0), (steps.at(u + 1) - steps.at(u)) / share, 0.0)
    return Rows(t, length, count)


def pack(rows: Rows, capacity: int) -> tuple[Bool[Array, " rays"], RaySamples]:
    """Samples of rays, one ray after the other in a list of `capacity` entries.

    Returns:
        Which rays have samples that all found room, for the others take no part; and the samples.
    """
    rays, slots = rows.t.shape
    end, entry = jnp.cumsum(rows.filled), jnp.arange(capacity, dtype=jnp.int32)
    fits = end <= capacity
    ends = jnp.zeros(capacity, jnp.int32).at[end].add(1, mode="drop")
    ray = barrier(jnp.minimum(jnp.cumsum(ends), rays - 1))
    of_ray = lambda a: a.at[ray].get(mode="promise_in_bounds")  # noqa: E731
    valid = (entry < end[-1]) & of_ray(fits)
    slot = jnp.clip(entry - of_ray(end - rows.filled), 0, slots - 1)
    at_place = lambda a: a.reshape(-1).at[ray * slots + slot].get(mode="promise_in_bounds")  # noqa: E731
    t, length = jnp.where(valid, at_place(rows.t), 1.0), jnp.where(valid, at_place(rows.length), 0.0)
    return fits & (rows.filled > 0), RaySamples(ray, slot, t, length, valid, rays, slots)
