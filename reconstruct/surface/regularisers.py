"""The four surface regularisers of surface points, as functions of arrays: L_d, L_n, L_b and L_s (section 4, supplement C, D)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

SPREAD = (0.15, 0.4)
"""Relative deviation over directions up to which a surface is no mirror, and from which on it is nothing else."""
DARK = 0.1
"""Channels darker than this, of the brightest, are left out."""


def density_smoothness(
    density: Float[Array, "rays n"],
    offsets: Float[Array, "rays n 3"],
    normals: Float[Array, "rays 3"],
    radius: Float[Array, " rays"],
    form: str,
) -> Float[Array, " rays"]:
    """L_d: density around a surface point agrees with its tangent plane.

    With alpha = 1 - exp(-density * radius), free of the scene's scale, and r the unit offset of a sample, "tangent" is
    alpha |r . n|, which vanishes for a sheet in the plane; "published" is alpha |1 - r . n|, as in the published implementation.
    """
    optical_depth = jnp.minimum(density * radius[:, None], 80.0)
    alpha = -jnp.expm1(-optical_depth)
    along = jnp.einsum("rnx,rx->rn", offsets, normals)
    return jnp.mean(alpha * jnp.abs(along if form == "tangent" else 1 - along), -1)


def normal_consistency(normals: Float[Array, "rays n 3"], surface_normal: Float[Array, "rays 3"]) -> Float[Array, " rays"]:
    """L_n: mean of (1 - |n_i . n|) / 2 over the samples around a surface point."""
    return jnp.mean((1 - jnp.abs(jnp.einsum("rnx,rx->rn", normals, surface_normal))) / 2, -1)


def lambertian_bias(specular: Float[Array, "rays n 3"]) -> Float[Array, " rays"]:
    """L_b: what stays constant in the specular colour belongs to the diffuse one: its magnitude, relative to its maximum.

    The maximum over directions and channels is held constant (supplement C).
    """
    largest = jax.lax.stop_gradient(jnp.max(specular, axis=(1, 2), keepdims=True))
    return jnp.mean(jnp.sum(jnp.square(specular / jnp.maximum(largest, 1e-4)), -1), -1)


def metal_or_not(diffuse: Float[Array, "rays 3"], specular: Float[Array, "rays n 3"]) -> Float[Array, " rays"]:
    """L_b for two kinds of surface: what mirrors has no diffuse colour, and elsewhere what stays constant is diffuse.

    A metal's colour changes with the direction, a dielectric's hardly does beside its diffuse colour. Either the diffuse colour
    counts, or the least reflection over the directions, both relative to the whole colour; see `mirrors` for which.
    """
    whole = jax.lax.stop_gradient(jnp.mean(diffuse, -1) + jnp.mean(specular, (1, 2)))
    metal = mirrors(diffuse, specular)
    unwanted = metal * jnp.mean(diffuse, -1) + (1 - metal) * jnp.mean(jnp.min(specular, 1), -1)
    return unwanted / jnp.maximum(whole, 1e-3)


def mirrors(diffuse: Float[Array, "rays 3"], specular: Float[Array, "rays n 3"]) -> Float[Array, " rays"]:
    """From 0 to 1, as data: how far the colour's relative deviation over directions is from the low end of `SPREAD`.

    The channel that deviates least decides: a reflection on paint is grey and the paint is not, while a metal tints all that it
    reflects. Channels much darker than the brightest one are left out.
    """
    diffuse, specular = jax.lax.stop_gradient((diffuse, specular))
    middle = jnp.mean(specular, 1)
    deviation = jnp.sqrt(jnp.mean(jnp.square(specular - middle[:, None]), 1))
    whole = diffuse + middle
    dark = whole < DARK * jnp.max(whole, -1, keepdims=True)
    share = jnp.min(jnp.where(dark, jnp.inf, deviation / jnp.maximum(whole, 1e-3)), -1)
    low, high = SPREAD
    along = jnp.clip((share - low) / (high - low), 0.0, 1.0)
    return along * along * (3 - 2 * along)


def direction_likeness(directions: Float[Array, "rays n 3"]) -> Float[Array, "rays n n"]:
    """Cosine of the angles between unit directions, as data: neighbours in a graph are those of the largest."""
    held = jax.lax.stop_gradient(directions)
    return jnp.einsum("rix,rjx->rij", held, held)


def specular_variation(
    specular: Float[Array, "rays n 3"], likeness: Float[Array, "rays n n"], neighbours: int
) -> Float[Array, " rays"]:
    """L_s: graph total variation over directions (supplement D), the mean |c_i - c_j| over the nearest j by `likeness`.

    Gradients go to the sample and not to its neighbours.
    """
    held, wanted = jax.lax.stop_gradient(specular), min(neighbours, likeness.shape[1] - 1)
    total = jnp.zeros(specular.shape[0], specular.dtype)
    for nearest in _nearest(likeness, wanted):
        other = jnp.take_along_axis(held, nearest[..., None], 1)
        total = total + jnp.mean(jnp.sum(jnp.abs(specular - other), -1), -1)
    return total / max(wanted, 1)


def _nearest(likeness: Float[Array, "rays n n"], wanted: int) -> list[Int[Array, "rays n"]]:
    """For each direction the `wanted` others most like it, the first of them first; differences below 1e-5 do not count.

    Repeated maximum, which for a handful beats a sort: of whole numbers that hold a likeness and, in their last bits, its index.
    They are unique and their maximum is taken down the columns of a matrix that is symmetric, both for the sake of vectors.
    """
    count = likeness.shape[1]
    bits = max(count - 1, 1).bit_length()
    shifted = (likeness + 2).astype(jnp.float32)  # in [1, 3]: positive numbers have the order of their bits
    index = jnp.arange(count, dtype=jnp.int32)[:, None]
    keys = (jax.lax.bitcast_convert_type(shifted, jnp.int32) >> bits << bits) | (count - 1 - index)
    keys = jnp.where(jnp.eye(count, dtype=bool), 0, keys)
    found = []
    for _ in range(wanted):
        largest = jnp.max(keys, 1)
        found.append(count - 1 - (largest & ((1 << bits) - 1)))
        keys = jnp.where(keys == largest[:, None], 0, keys)
    return found
