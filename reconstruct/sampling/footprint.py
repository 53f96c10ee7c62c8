"""Which part of its conical frustum a sample stands for."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from reconstruct.field.cloud import Cloud, gaussians_in_frustums, hexagons_in_frustums, points_on_rays
from reconstruct.sampling.samples import RaySamples
from reconstruct.scene.rays import Rays


class Footprint(eqx.Module):
    """What stands for the conical frustum of a sample."""

    kind: str = eqx.field(static=True, default="point")
    """"point", "gaussian" (Mip-NeRF) or "hexagon" (Zip-NeRF)."""
    turn: Float[Array, " rays"] | None = None
    """Angle by which each ray's hexagons are turned about it [rad]."""


def cloud_of(rays: Rays, samples: RaySamples, *, bounded: bool, footprint: Footprint) -> Cloud:
    """Places of the samples."""
    if footprint.kind == "point":
        return points_on_rays(rays, samples.ray, samples.t, bounded)
    if footprint.turn is None:
        return gaussians_in_frustums(rays, samples.ray, samples.t, samples.length / 2, bounded)
    centre, half = samples.padded(samples.t), samples.padded(samples.length) / 2
    edges = jnp.concatenate([centre - half, centre[:, -1:] + half[:, -1:]], -1)
    return hexagons_in_frustums(rays, edges, footprint.turn, bounded)
