"""Which samples of a ray light reaches: before a step is differentiated, the density alone is evaluated from front to back.

What is behind an opaque surface has no weight and no gradient. In front of a blank background that is up to two thirds of the
samples that an occupancy grid lets through, since it knows of a cell only that there is something in it.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.volume import SPENT, optical_depth_in_rows, sum_before
from koala3d.reconstruct.sampling.samples import Footprint, RaySamples, Rows, cloud_of
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Space

TOGETHER = 6
"""Slots of a ray that are looked at in each of the first rounds."""
ROOM = (1, 2, 8)
"""One of so many rays finds room in each round: most end in the first one."""

Densities = Callable[[Cloud], Float[Array, " n"]]


def in_sight(density_of: Densities, rays: Rays, rows: Rows, space: Space, *, solid: bool) -> Rows:
    """The rows without the samples behind `SPENT`. A ray that finds no room in a round keeps all of them.

    Args:
        density_of: densities at places [1 / scene unit].
        solid: as of `optical_depth`.
    """
    count, slots = rows.t.shape
    depth, last = jnp.zeros(count), jnp.zeros(count)
    kept, goes_on, first = rows.filled, rows.filled > 0, 0
    for number, one_of in enumerate(ROOM, 1):
        end = slots if number == len(ROOM) else min(first + TOGETHER, slots)
        if first == end:
            break
        (those,) = jnp.nonzero(goes_on, size=-(-count // one_of), fill_value=count)
        part = Rows(rows.t[:, first:end], rows.length[:, first:end], rows.filled - first)
        own_rays, part, *so_far = _taken((rays, part, depth, last), those)
        behind, density, lit = _looked_at(density_of, own_rays, part, *so_far, space, solid)
        spent = behind >= SPENT
        kept = kept.at[those].min(jnp.where(spent, first + lit, slots), mode="drop")
        depth, last = depth.at[those].set(behind, mode="drop"), last.at[those].set(density, mode="drop")
        goes_on = jnp.zeros(count, bool).at[those].set(~spent & (part.filled > end - first), mode="drop")
        first = end
    return barrier(rows._replace(filled=kept))


def _taken(tree: Any, those: Int[Array, " n"]) -> Any:
    """Some of the rays; for one past the last, the last."""
    return jax.tree.map(lambda a: a.at[those].get(mode="clip"), tree)


def _looked_at(
    density_of: Densities,
    rays: Rays,
    rows: Rows,
    depth: Float[Array, " n"],
    last: Float[Array, " n"],
    space: Space,
    solid: bool,
) -> tuple[Float[Array, " n"], Float[Array, " n"], Int[Array, " n"]]:
    """Optical depth behind these samples of rays, the density of each ray's last one, and how many of them light reaches.

    Args:
        depth: optical depth in front of them.
        last: density of the sample in front of them [1 / scene unit].
    """
    samples = RaySamples.in_rows(*rows)
    density = density_of(barrier(cloud_of(rays, samples, space=space, footprint=Footprint()))).reshape(rows.t.shape)
    lengths = samples.length.reshape(rows.t.shape) * rays.speed[:, None]
    found = optical_depth_in_rows(density, last, lengths, solid=solid)
    lit = jnp.sum(depth[:, None] + sum_before(found) < SPENT, -1, dtype=rows.filled.dtype)
    return barrier((depth + jnp.sum(found, -1), density[:, -1], lit))
