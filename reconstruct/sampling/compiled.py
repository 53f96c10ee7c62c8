"""Choosing samples along rays through compiled kernels: the occupancy grid's expectation, the draw, the packed list."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from koala3d.reconstruct.kernels import native
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.samples import RaySamples
from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Ball, Box, Space

MAPS: dict[type[Space], int] = {Box: 0, Ball: 1, Frustum: 2}
"""As `reconstruct.kernels.loops.march` numbers them."""


def usable(rays: Rays) -> bool:
    """Whether the functions of this file are for these rays."""
    return native.usable(rays.origins, rays.directions)


def expected_depth(
    occupancy: Occupancy, rays: Rays, steps: Steps, jitter: Float[Array, " n"], space: Space
) -> tuple[Float[Array, "n steps"], Bool[Array, " n"]]:
    """As `reconstruct.sampling.packing.expected_depth`, and which rays have an occupied step."""
    count = rays.origins.shape[0]
    results = [native.float32(count, steps.count), jax.ShapeDtypeStruct((count,), jnp.bool_)]
    choices = np.array(_way(occupancy, steps, space), np.int32)
    arguments = (rays.origins, rays.directions, _cuts(steps), jitter, occupancy.depth, choices, _numbers(space))
    depth, hit = native.call("march", results, *arguments)
    return depth, hit


def shown_samples(occupancy: Occupancy, rays: Rays, steps: Steps, space: Space, *, max_per_ray: int) -> RaySamples:
    """As `expected_depth` and `packed_samples` with jitter and offset of one half, in rows."""
    count = rays.origins.shape[0]
    results = [native.float32(count, max_per_ray)] * 2 + [jax.ShapeDtypeStruct((count,), jnp.int32)]
    choices = np.array([*_way(occupancy, steps, space), max_per_ray, max_per_ray - 1], np.int32)
    arguments = (rays.origins, rays.directions, _cuts(steps), occupancy.depth, choices, _numbers(space))
    return RaySamples.in_rows(*native.call("look", results, *arguments))


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


def _way(occupancy: Occupancy, steps: Steps, space: Space) -> list[int]:
    return [steps.front, steps.inside, steps.behind, occupancy.grid, occupancy.outer_grid, MAPS[type(space)]]


def _numbers(space: Space) -> Float[np.ndarray, " 17"]:
    """What a frustum's map is made of; zeros for other spaces."""
    if not isinstance(space, Frustum):
        return np.zeros(17, np.float32)
    sizes = [space.across, space.deep, space.slope, 1 / space.far, space.smallest]
    return np.array([*np.ravel(space.rotation), *space.origin, *sizes], np.float32)
