"""Samples of many rays in one flat list, whatever chose them, and which part of its conical frustum each stands for."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from koala3d.reconstruct.field.cloud import Cloud, gaussians_in_frustums, hexagons_in_frustums, points_on_rays
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Space


class Rows(NamedTuple):
    """Samples of each ray, first in its row: t and length as in `RaySamples`, 1 and 0 in the slots that are not filled."""

    t: Float[Array, "rays slots"]
    length: Float[Array, "rays slots"]
    filled: Int[Array, " rays"]

    def first_filled(self, count: int) -> tuple[Int[Array, " count"], "Rows"]:
        """The first `count` rows with samples and their indices; rows without any follow if there are fewer."""
        (order,) = jnp.nonzero(self.filled, size=count, fill_value=0)
        there = jnp.arange(count) < jnp.count_nonzero(self.filled)
        return order, Rows(self.t[order], self.length[order], jnp.where(there, self.filled[order], 0))


class RaySamples(eqx.Module):
    """A list of samples ordered by ray, then by distance.

    Each ray owns at most `max_per_ray` consecutive entries; entries past the last sample of the list, or of a ray that has
    room for more, are not `valid` and carry length zero. `padded` lays values out as (rays, max_per_ray) for what runs along
    a ray.
    """

    ray: Int[Array, " n"]
    """Index of the ray."""
    slot: Int[Array, " n"]
    """Position among the ray's own samples."""
    t: Float[Array, " n"]
    """Where the field is evaluated, in multiples of the ray's direction."""
    length: Float[Array, " n"]
    """Extent of the interval that the sample stands for, in the same unit."""
    valid: Bool[Array, " n"]
    """False for entries that fill the list."""
    num_rays: int = eqx.field(static=True)
    max_per_ray: int = eqx.field(static=True)

    @classmethod
    def from_edges(cls, tdist: Float[Array, "rays edges"]) -> "RaySamples":
        """Every interval of every ray, evaluated at its centre."""
        rays, slots = tdist.shape[0], tdist.shape[1] - 1
        length = tdist[:, 1:] - tdist[:, :-1]
        return cls.in_rows((tdist[:, 1:] + tdist[:, :-1]) / 2, length, jnp.full(rays, slots))

    @classmethod
    def in_rows(
        cls, t: Float[Array, "rays slots"], length: Float[Array, "rays slots"], count: Int[Array, " rays"]
    ) -> "RaySamples":
        """The first `count` of each row's samples, in a list that has room for all."""
        rays, slots = t.shape
        ray, slot = jnp.repeat(jnp.arange(rays), slots), jnp.tile(jnp.arange(slots), rays)
        valid = (jnp.arange(slots) < count[:, None]).reshape(-1)
        return cls(ray, slot, t.reshape(-1), jnp.where(valid, length.reshape(-1), 0.0), valid, rays, slots)

    def padded(self, values: Float[Array, " n"]) -> Float[Array, "rays slots"]:
        """Values as a table of (rays, max_per_ray), zero where a ray has fewer samples."""
        flat = jnp.zeros(self.num_rays * self.max_per_ray, values.dtype)
        return flat.at[self._position].add(jnp.where(self.valid, values, 0)).reshape(self.num_rays, self.max_per_ray)

    def packed(self, table: Float[Array, "rays slots"]) -> Float[Array, " n"]:
        """Inverse of `padded`; zero for entries that are not valid."""
        return jnp.where(self.valid, table.reshape(-1).at[self._position].get(mode="promise_in_bounds"), 0)

    @property
    def _position(self) -> Int[Array, " n"]:
        return self.ray * self.max_per_ray + self.slot


class Footprint(eqx.Module):
    """What stands for the conical frustum of a sample."""

    kind: str = eqx.field(static=True, default="point")
    """"point", "gaussian" (Mip-NeRF) or "hexagon" (Zip-NeRF)."""
    turn: Float[Array, " rays"] | None = None
    """Angle by which each ray's hexagons are turned about it [rad]."""

    def of(self, ray: Int[Array, " n"]) -> "Footprint":
        """That of some of the rays, by their indices."""
        return self if self.turn is None else Footprint(self.kind, self.turn[ray])


def cloud_of(rays: Rays, samples: RaySamples, *, space: Space, footprint: Footprint) -> Cloud:
    """Places of the samples."""
    if footprint.kind == "point":
        return points_on_rays(rays, samples.ray, samples.t, space)
    if footprint.turn is None:
        return gaussians_in_frustums(rays, samples.ray, samples.t, samples.length / 2, space)
    centre, half = samples.padded(samples.t), samples.padded(samples.length) / 2
    edges = jnp.concatenate([centre - half, centre[:, -1:] + half[:, -1:]], -1)
    return hexagons_in_frustums(rays, edges, footprint.turn, space)
