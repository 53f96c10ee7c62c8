"""Samples along rays through compiled kernels: `sample` and `pack` as in `plain`."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from koala3d.reconstruct.kernels import native
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.samples import RaySamples, Rows
from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Ball, Box, Space

MAPS: dict[type[Space], int] = {Box: 0, Ball: 1, Frustum: 2}
"""As `reconstruct.kernels.loops.march` numbers them."""


def usable(rays: Rays) -> bool:
    """Whether the kernels are for these rays."""
    return native.usable(rays.origins, rays.directions)


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
    """As `reconstruct.sampling.plain.sample`."""
    count = rays.origins.shape[0]
    results = [native.float32(count, max_per_ray)] * 2 + [jax.ShapeDtypeStruct((count,), jnp.int32)]
    cuts = jnp.stack([steps.near, steps.enter, steps.leave, steps.far])
    parts = (steps.front, steps.inside, steps.behind)
    choices = np.array([*parts, occupancy.grid, occupancy.outer_grid, MAPS[type(space)]], np.int32)
    wanted = jnp.full(2, count * max_per_ray + 1) if enough is None else enough  # more than there can be: all rays
    arguments = (rays.origins, rays.directions, cuts, jitter, offset, occupancy.depth, choices, _numbers(space), wanted)
    return Rows(*native.call("sample", results, *arguments))


def pack(rows: Rows, capacity: int) -> tuple[Bool[Array, " rays"], RaySamples]:
    """As `reconstruct.sampling.plain.pack`."""
    kinds = (jnp.int32, jnp.int32, jnp.float32, jnp.float32, jnp.bool_)
    rays, slots = rows.t.shape
    lists = [jax.ShapeDtypeStruct((capacity,), kind) for kind in kinds]
    used, *of_samples = native.call("pack", [jax.ShapeDtypeStruct((rays,), jnp.bool_), *lists], *rows)
    return used, RaySamples(*of_samples, rays, slots)


def _numbers(space: Space) -> Float[np.ndarray, " 17"]:
    """What a frustum's map is made of; zeros for other spaces."""
    if not isinstance(space, Frustum):
        return np.zeros(17, np.float32)
    sizes = [space.across, space.deep, space.slope, 1 / space.far, space.smallest]
    return np.array([*np.ravel(space.rotation), *space.origin, *sizes], np.float32)
