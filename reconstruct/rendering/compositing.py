"""From samples along rays to rays: emission and absorption of packed samples."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from koala3d.reconstruct.field.appearance import Material
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.field.parallax import places_on
from koala3d.reconstruct.kernels import compositing
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.volume import volume_weights
from koala3d.reconstruct.sampling.samples import RaySamples
from koala3d.reconstruct.scene.rays import Rays


def composited(
    density: Float[Array, " n"],
    values: tuple[Float[Array, "_ n"], ...],
    samples: RaySamples,
    speed: Float[Array, " rays"],
) -> tuple[Float[Array, "rays slots"], Float[Array, "channels rays"]]:
    """Weights of samples, and sums over each ray of weights, of weighted t and of weighted values, one after the other.

    Args:
        density: at least 0 [1 / scene unit].
        speed: length of each ray's direction [scene unit per t].
    """
    values = tuple(value for value in values if value.shape[0])
    if compositing.takes(density, values):
        interval = (samples.ray, samples.slot, samples.t, samples.length, samples.valid, speed)
        return compositing.composited(density, values, interval, samples.max_per_ray)
    weights = barrier(sample_weights(density, samples, speed))
    flat = barrier(samples.packed(weights))
    return weights, composite(jnp.concatenate([jnp.ones_like(flat)[None], samples.t[None], *values]), flat, samples).T


def sample_weights(density: Float[Array, " n"], samples: RaySamples, speed: Float[Array, " rays"]) -> Float[Array, "rays slots"]:
    """`volume_weights` of packed samples; `speed` is the length of each ray's direction [scene unit per t]."""
    return volume_weights(samples.padded(density), samples.padded(samples.length) * speed[:, None])


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
