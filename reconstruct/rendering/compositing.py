"""From samples along rays to rays: emission and absorption of packed samples."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from koala3d.reconstruct.field.appearance import Material
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.field.parallax import places_on
from koala3d.reconstruct.kernels import compositing
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.volume import optical_depth, volume_weights
from koala3d.reconstruct.sampling.samples import RaySamples
from koala3d.reconstruct.scene.rays import Rays


def packed_depth(
    field: Field, density: Float[Array, " n"], samples: RaySamples, speed: Float[Array, " rays"]
) -> Float[Array, " n"]:
    """`optical_depth` of packed samples.

    Args:
        speed: length of each ray's direction [scene unit per t].
    """
    before = jnp.where(samples.slot > 0, jnp.roll(density, 1), 0.0)
    lengths = samples.length * speed.at[samples.ray].get(mode="promise_in_bounds")
    return optical_depth(density, before, lengths, solid=field.solid)


def lost_at(t: Float[Array, "*n"], before: Float[Array, "*n"], *, solid: bool) -> Float[Array, "*n"]:
    """t at which a sample's light is lost: in a fog around the sample, on a solid between it and the one in front.

    Args:
        before: t of the sample in front; that of the sample itself in front of which there is none.
    """
    return (t + before) / 2 if solid else t


def composited(
    depth: Float[Array, " n"], values: tuple[Float[Array, "_ n"], ...], samples: RaySamples
) -> tuple[Float[Array, "rays slots"], Float[Array, "channels rays"]]:
    """Weights of samples, and sums over each ray of weights, of weighted t and of weighted values, one after the other.

    Args:
        depth: optical depth of each sample.
    """
    values = tuple(value for value in values if value.shape[0])
    if compositing.takes(depth, values):
        places = (samples.ray, samples.slot, samples.t, samples.valid)
        return compositing.composited(depth, values, places, (samples.num_rays, samples.max_per_ray))
    weights = barrier(volume_weights(samples.padded(depth)))
    flat = barrier(samples.packed(weights))
    return weights, composite(jnp.concatenate([jnp.ones_like(flat)[None], samples.t[None], *values]), flat, samples).T


def composite(
    values: Float[Array, "channels n"], weights: Float[Array, " n"], samples: RaySamples
) -> Float[Array, "rays channels"]:
    """Sum of weighted sample values over each ray."""
    rows = (values * weights).T
    return jnp.zeros((samples.num_rays, values.shape[0]), values.dtype).at[samples.ray].add(rows, mode="promise_in_bounds")


def values_of(field: Field, material: Material, rays: Rays, samples: RaySamples) -> tuple[Float[Array, "_ n"], ...]:
    """What is composited of each sample: the material and, where samples are shaded, colour and specular part."""
    light = None if field.deferred else Lit.on(rays, samples.t, samples.ray)
    material = field.under_lamps(material, light)
    if field.deferred:
        return material.parts
    directions = rays.viewdirs.at[samples.ray].get(mode="promise_in_bounds").T
    places = places_on(rays, samples.t, samples.ray) if field.appearance.parallax is not None else None
    shading = barrier(field.shade(material, directions, light=light, places=places))
    return (*material.parts, shading.rgb, shading.specular)
