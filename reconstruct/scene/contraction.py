"""Unbounded space into a ball of radius 2 (Mip-NeRF 360, Barron et al. 2022, equation 10).

contract(x) = x                          where |x| <= 1
              (2 - 1/|x|) x / |x|        elsewhere
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from koala3d.reconstruct.numerics.safe import normalise, safe_norm


def contract(points: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Points of the normalised scene, mapped into the ball of radius 2; identity inside the unit ball."""
    radius = safe_norm(points)[..., None]
    outside = radius > 1
    safe_radius = jnp.where(outside, radius, 1.0)
    return jnp.where(outside, (2 - 1 / safe_radius) * normalise(points), points)


def contract_coordinates(
    x: Float[Array, "*batch"], y: Float[Array, "*batch"], z: Float[Array, "*batch"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"], Float[Array, "*batch"]]:
    """`contract` of three arrays of coordinates, for hot loops: a reciprocal root alone, not safe to differentiate."""
    inverse = jax.lax.rsqrt(jnp.maximum(x * x + y * y + z * z, 1.0))
    x, y, z = (v * ((2 - inverse) * inverse) for v in (x, y, z))
    return x, y, z


def contraction_scale(points: Float[Array, "*batch 3"]) -> Float[Array, "*batch"]:
    """Cube root of the Jacobian's determinant: by how much `contract` scales a small Gaussian's width.

    The determinant is radial slope times the square of the tangential one: r^-2 * ((2 - 1/r) / r)^2.
    Powers are taken one by one, which keeps the gradient finite however far away a point is.
    """
    inverse = 1 / jnp.maximum(safe_norm(points), 1.0)
    return jnp.cbrt(jnp.square(2 - inverse)) * jnp.power(inverse, 4 / 3)


def pull_back(points: Float[Array, "*points 3"], gradient: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Gradient to scene coordinates from a gradient to contracted ones, at scene `points`: the (symmetric) Jacobian applied.

    The batch may have axes in front of those of the points.
    """
    radius = safe_norm(points)[..., None]
    outside = radius > 1
    safe_radius = jnp.where(outside, radius, 1.0)
    outward = normalise(points)
    along = jnp.sum(gradient * outward, -1, keepdims=True) * outward
    tangential = (2 - 1 / safe_radius) / safe_radius
    return jnp.where(outside, tangential * (gradient - along) + along / safe_radius**2, gradient)
