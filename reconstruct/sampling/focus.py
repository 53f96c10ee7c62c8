"""Which rays are worth their samples where an object stands among surroundings: those that meet the object.

Surroundings fill most of a picture and say little of the object's shape. A step draws more rays than it takes; the occupancy grid
tells which of them meet matter in the object's box, and those are taken sooner.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.steps import box_interval
from koala3d.reconstruct.scene.rays import Rays

PLACES = 16
"""Places along a ray's way through the box at which the grid is looked up."""
INSET = 0.03
"""So much of the box, at all its sides, does not count: what an object stands on may reach into it."""
CANDIDATES = 4
"""Rays drawn for each that is taken, where the object's box is stated. Where it is only what the pictures suggest, it may hold
anything, and what is around it is as much of the scene."""
BESIDE = 0.1
"""Weight of a ray that meets nothing in the box; each that surely meets something has 1 more."""


def weights(occupancy: Occupancy, rays: Rays, half_box: Float[Array, " 3"], jitter: Float[Array, " n"]) -> Float[Array, " n"]:
    """How soon each ray should be taken: the opacity that the grid expects in the object's box, and `BESIDE`.

    Args:
        half_box: as of `Bounds`.
        jitter: where in its step each place lies, 0 to 1.
    """
    enter, leave = box_interval(rays, half_box * (1 - INSET))
    enter = jnp.maximum(enter, 0.0)  # what is behind the camera is not met
    step = jnp.maximum(leave - enter, 0.0) / PLACES
    t = enter[:, None] + (jnp.arange(PLACES) + jitter[:, None]) * step[:, None]
    x, y, z = (rays.origins[:, i, None] + t * rays.directions[:, i, None] for i in range(3))
    depth = occupancy.depth.at[occupancy.cell(x, y, z)].get(mode="promise_in_bounds").astype(jnp.float32)
    cells_per_step = step * rays.speed * (occupancy.grid / 2)
    return BESIDE - jnp.expm1(-jnp.sum(depth, -1) * cells_per_step)


def taken(key: PRNGKeyArray, weight: Float[Array, " n"], count: int) -> Int[Array, " count"]:
    """Indices of `count` entries, drawn one after the other in proportion to their weights, none twice.

    Those are the largest sums of a weight's logarithm and Gumbel noise (Yellott 1977; Efraimidis and Spirakis 2006).
    """
    return jax.lax.top_k(jnp.log(weight) + jax.random.gumbel(key, weight.shape), count)[1]
