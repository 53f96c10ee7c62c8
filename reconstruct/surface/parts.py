"""Which part of a colour is diffuse, asked where the cameras see a surface."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from koala3d.reconstruct.field.appearance import Material
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.field.parallax import places_on
from koala3d.reconstruct.numerics.safe import normalise
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.surface.first_surface import Surface
from koala3d.reconstruct.surface.place import Place
from koala3d.reconstruct.surface.regularisers import metal_or_not

CAMERAS = 32
"""Cameras of a batch in whose directions each point is looked at."""


def bias_for_two_kinds(field: Field, place: Place, rays: Rays, surface: Surface) -> Float[Array, " n"]:
    """`metal_or_not` of each surface point, as cameras of the batch see it.

    A training can move light from one part to the other in many ways, most of which spoil the shape or the light. So the
    gradient goes to the diffuse colour and the tint alone; the normals, the roughness and the light are held. What pictures leave
    open is little more than one constant for the whole scene, so the gradient ends at the layer that both come from: the features
    before it are the density's too, and an object whose features are pushed about grows.
    """
    cloud = place.of(rays, surface)
    _, material = field.held_but_for_heads()(cloud)
    held: Material = jax.lax.stop_gradient(material)
    towards = towards_surface(cloud.points, rays.origins[:CAMERAS], held.normals_pred)
    count = towards.shape[1]
    live = Material(held.diffuse, material.tint, held.roughness, held.normals_pred, held.bottleneck)
    repeated = Material.unstacked(jnp.repeat(live.stacked(), count, axis=1))
    light, places = Lit.on(rays, surface.t, surface.ray), places_on(rays, surface.t, surface.ray)
    shading = jax.lax.stop_gradient(field).shade(
        repeated,
        towards.reshape(-1, 3).T,
        light=None if light is None else light.repeated(count),
        places=jnp.repeat(places, count, axis=1),
    )
    return metal_or_not(material.diffuse.T, shading.specular.T.reshape(towards.shape))


def at_object(place: Place, rays: Rays, surface: Surface, factor: float | Float[Array, ""]) -> Float[Array, " n"]:
    """`factor` for surface points in the object's ball, as data; one for those around it."""
    points = place.of(rays, surface).points
    return jax.lax.stop_gradient(jnp.where(jnp.sum(points * points, 0) < 1, factor, 1.0))


def towards_surface(
    points: Float[Array, "3 n"], cameras: Float[Array, "cameras 3"], normals: Float[Array, "3 n"]
) -> Float[Array, "n cameras 3"]:
    """Unit directions from the cameras to each surface point; turned round for cameras behind the surface.

    As data: no gradient goes through them.
    """
    towards = normalise(points.T[:, None] - cameras[None], axis=-1)
    facing = jnp.sum(towards * normals.T[:, None], -1, keepdims=True)
    return jax.lax.stop_gradient(jnp.where(facing > 0, -towards, towards))
