"""Choosing samples along rays through compiled kernels: the occupancy grid's expectation, the draw, the packed list."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from reconstruct.kernels import native
from reconstruct.sampling.occupancy import Occupancy
from reconstruct.sampling.samples import RaySamples
from reconstruct.sampling.steps import Steps
from reconstruct.scene.rays import Rays
from reconstruct.scene.space import Ball, Box, Space


def marches(space: Space, rays: Rays) -> bool:
    """Whether `expected_depth` is for rays in this space."""
    return isinstance(space, Box | Ball) and packs(rays)


def packs(rays: Rays) -> bool:
    """Whether `packed_samples` is for these rays."""
    return native.usable(rays.origins, rays.directions)


def expected_depth(
    occupancy: Occupancy, rays: Rays, steps: Steps, jitter: Float[Array, " n"], space: Space
) -> tuple[Float[Array, "n steps"], Bool[Array, " n"]]:
    """As `reconstruct.sampling.packing.expected_depth`, and which rays have an occupied step."""
    count = rays.origins.shape[0]
    choices = [steps.front, steps.inside, steps.behind, occupancy.grid, occupancy.outer_grid, isinstance(space, Ball)]
    results = [native.float32(count, steps.count), jax.ShapeDtypeStruct((count,), jnp.bool_)]
    arguments = (rays.origins, rays.directions, _cuts(steps), jitter, occupancy.depth, np.array(choices, np.int32))
    depth, hit = native.call("march", results, *arguments)
    return depth, hit


def packed_samples(
    depth: Float[Array, "rows steps"],
    order: Int[Array, " rays"],
    chosen: Int[Array, ""],
    steps: Steps,
    jitter: Float[Array, " rays"],
    offset: Float[Array, " rays"],
    *,
    capacity: int,
    max_per_ray: int,
) -> tuple[RaySamples, Bool[Array, " rays"]]:
    """As `draw_probability`, `draw` and `packed_samples` of `reconstruct.sampling.packing` one after the other.

    Args:
        order: row of `depth` that belongs to each ray.
        chosen: the first so many rays have depth, the others none.
    """
    count = order.shape[0]
    choices = np.array([steps.front, steps.inside, steps.behind, max_per_ray, max_per_ray - 1], np.int32)
    kinds = (jnp.int32, jnp.int32, jnp.float32, jnp.float32, jnp.bool_)
    results = [jax.ShapeDtypeStruct((capacity,), kind) for kind in kinds]
    results += [jax.ShapeDtypeStruct((count,), jnp.bool_), jax.ShapeDtypeStruct((count,), jnp.int32)]
    results += [native.float32(count, max_per_ray)] * 2
    arguments = (depth, order.astype(jnp.int32), jnp.reshape(chosen, 1).astype(jnp.int32), offset, jitter, _cuts(steps), choices)
    ray, slot, t, length, valid, fits, *_ = native.call("pack", results, *arguments)
    return RaySamples(ray, slot, t, length, valid, count, max_per_ray), fits


def _cuts(steps: Steps) -> Float[Array, "4 n"]:
    return jnp.stack([steps.near, steps.enter, steps.leave, steps.far])
