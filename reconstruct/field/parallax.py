"""The parallax of near lamps: one light for all places, as it is on a sphere about the object.

A reflected ray from the place x along the unit direction d ends on the sphere of radius R at

    x + s d,   s = -x.d + sqrt((x.d)^2 + R^2 - |x|^2),

and what is encoded is the direction from the sphere's centre to that end (box-projected reflections of computer graphics, with a
sphere for the box). Written in 1 / R this is d itself, to the bit, for an infinite radius.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.config import LightConfig
from koala3d.reconstruct.scene.rays import Rays

INSIDE = 0.9
"""Places further out than this share of the radius are taken to be as far out as it: rays from there still end on the sphere."""
START = 10.0
"""Radius with which learning begins [scene unit]."""


class Parallax(eqx.Module):
    """A sphere about the scene's origin, on which reflected rays end."""

    inverse: float = eqx.field(static=True)
    """One over the radius [1 / scene unit], in [0, 1)."""
    logit: Float[Array, ""] | None = None
    """The same where it is learned, as the argument of a sigmoid: the sphere stays larger than the object's ball."""

    @classmethod
    def of(cls, light: LightConfig) -> "Parallax | None":
        """As configured; None where light comes from afar."""
        if light.parallax is None:
            return None
        if light.parallax != "learned":
            return cls(1 / light.parallax)
        return cls(1 / START, jnp.asarray(-math.log(START - 1), jnp.float32))

    def towards(self, directions: Float[Array, "3 n"], places: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
        """Unit directions from the sphere's centre to where rays from `places` [scene unit] along unit `directions` end."""
        inverse = self.inverse if self.logit is None else jax.nn.sigmoid(self.logit)
        return ends_on_sphere(directions, inverse * places)


def places_on(rays: Rays, t: Float[Array, " n"], ray: Int[Array, " n"] | None = None) -> Float[Array, "3 n"]:
    """Places [scene unit] at distance t along rays, or along those with the given indices: data, no gradient goes to them."""
    get = lambda a: a if ray is None else a.at[ray].get(mode="promise_in_bounds")  # noqa: E731
    return jax.lax.stop_gradient((get(rays.origins) + get(rays.directions) * t[:, None]).T)


def ends_on_sphere(directions: Float[Array, "3 n"], places: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
    """Where rays along unit directions leave the unit sphere. Places beyond `INSIDE` of its radius are drawn in to there."""
    squared = jnp.sum(places * places, 0)
    outside = squared > INSIDE**2
    places = places * jnp.where(outside, INSIDE * jax.lax.rsqrt(jnp.where(outside, squared, 1.0)), 1.0)
    along = jnp.sum(places * directions, 0)
    squared = jnp.minimum(squared, INSIDE**2)
    return places + (jnp.sqrt(1 + (along * along - squared)) - along) * directions  # the root is of 1 - INSIDE^2 or more
