"""Rays composited front to back, a few samples at a time: what is behind an opaque surface is never evaluated.

Some thousand rays are under way at once. In each round the field is evaluated at their next `TOGETHER` samples; a ray that
light no longer passes, or that has no more samples, leaves its place to the next one of the queue. So all places are taken
until the queue ends, whatever the rays meet.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from koala3d.reconstruct.field.appearance import Material
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.volume import SPENT, optical_depth_in_rows, volume_weights
from koala3d.reconstruct.rendering.compositing import lost_at, values_of
from koala3d.reconstruct.sampling.sampler import Sampled
from koala3d.reconstruct.sampling.samples import RaySamples, cloud_of
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Space

UNDER_WAY, TOGETHER = (2048, 32768), 4
"""Rays that are under way at once, on a processor and elsewhere, and their samples that are evaluated together."""


class _Round(eqx.Module):
    """State between two rounds."""

    sums: Float[Array, "rays channels"]
    """Of each ray so far: its optical depth, the density of its last sample, then what is composited."""
    place: Int[Array, " places"]
    """Position of each ray under way in the queue; past its end where none is."""
    slot: Int[Array, " places"]
    """Its next sample."""
    next: Int[Array, ""]
    """First of the queue that has not begun."""


def sums_front_to_back(
    field: Field, rays: Rays, found: Sampled, queue: "Queue", space: Space, *, normals: bool, under_way: int | None = None
) -> Float[Array, "rays _"]:
    """Sums of weights, t and `values_of` over each ray of a queue, and of weighted unit density normals if they are wanted.

    Args:
        found: samples in rows.
        under_way: rays at once, where other than `UNDER_WAY`: fewer are better where most rays have no samples.
    """
    samples, most = found.samples, under_way or UNDER_WAY[jax.default_backend() != "cpu"]
    places = min(most, rays.radii.shape[0])
    shape = (samples.num_rays, samples.max_per_ray)
    t, length = samples.t.reshape(shape), samples.length.reshape(shape)
    spare = ((0, 0), (0, -shape[1] % TOGETHER))
    t = jnp.concatenate([t, jnp.broadcast_to(t[:, -1:] + length[:, -1:] / 2, (shape[0], spare[1][1]))], -1)  # where the last ends
    length = jnp.pad(length, spare)
    filled = jnp.sum(samples.valid.reshape(shape), -1)

    def contributions(ray: Int[Array, " places"], slot: Int[Array, " places"], active: Bool[Array, " places"], so_far: Array):
        """(places, 2 + channels): what is added to the sums of rays, of which these were found so far."""
        own = jax.tree.map(lambda v: v[ray], rays)
        column = slot[:, None] + jnp.arange(TOGETHER)
        extent = length[ray[:, None], column]
        own_t, t_before = t[ray[:, None], column], t[ray[:, None], jnp.maximum(column - 1, 0)]
        some = RaySamples.in_rows(own_t, extent, jnp.full(places, TOGETHER))
        cloud = barrier(cloud_of(own, some, space=space, footprint=found.footprint.of(ray)))
        density, material, normal = barrier(_evaluated(field, cloud, normals))
        channels = jnp.stack([jnp.ones_like(some.t), lost_at(own_t, t_before, solid=field.solid).reshape(-1)])
        channels = jnp.concatenate([channels, *values_of(field, material, own, some), normal])
        density, gone = density.reshape(places, TOGETHER), so_far[:, :2].T
        lengths = jnp.where(active[:, None], extent * own.speed[:, None], 0.0)
        depth = optical_depth_in_rows(density, gone[1], lengths, solid=field.solid)
        weights = barrier(volume_weights(depth) * jnp.exp(-gone[0])[:, None])
        more = jnp.stack([jnp.sum(depth, -1), jnp.where(active, density[:, -1] - gone[1], 0.0)])
        weighted = channels * weights.reshape(-1)
        sums = sum(weighted[:, k::TOGETHER] for k in range(TOGETHER))  # a reduction over so short an axis is three times as slow
        return jnp.concatenate([more, sums]).T

    def advance(now: _Round) -> _Round:
        active = now.place < queue.count
        ray = queue.ray[jnp.minimum(now.place, shape[0] - 1)]
        more = contributions(ray, now.slot, active, now.sums[ray])
        slot = now.slot + TOGETHER
        leaves = active & ((slot >= filled[ray]) | (now.sums[ray, 0] + more[:, 0] > SPENT))
        place = jnp.where(leaves, now.next + jnp.cumsum(leaves) - 1, now.place)
        return _Round(now.sums.at[ray].add(more), place, jnp.where(leaves, 0, slot), now.next + jnp.sum(leaves))

    first = jnp.arange(places)
    zero = jnp.zeros(places, first.dtype)
    shapes = jax.eval_shape(contributions, zero, zero, zero > 0, jnp.zeros((places, 2)))
    start = _Round(jnp.zeros((shape[0], shapes.shape[1])), first, zero, jnp.asarray(places))
    return jax.lax.while_loop(lambda now: jnp.any(now.place < queue.count), advance, start).sums[:, 2:]


class Queue(eqx.Module):
    """Rays that have samples."""

    ray: Int[Array, " rays"]
    """Their indices, the first `count` of them."""
    count: Int[Array, ""]

    @classmethod
    def of(cls, samples: RaySamples, count: Int[Array, ""]) -> "Queue":
        """Those of the first `count` rays; samples in rows."""
        any_sample = samples.valid.reshape(samples.num_rays, -1)[:, 0] & (jnp.arange(samples.num_rays) < count)
        (ray,) = jnp.nonzero(any_sample, size=samples.num_rays, fill_value=0)
        return cls(ray, jnp.sum(any_sample))


def _evaluated(field: Field, cloud: Cloud, normals: bool) -> tuple[Float[Array, " n"], Material, Float[Array, "_ n"]]:
    """Density and material, and unit density normals if they are wanted."""
    return field.with_normals(cloud) if normals else (*field(cloud), jnp.zeros((0, cloud.points.shape[1] // cloud.group)))
