"""Losses of Mip-NeRF 360, Zip-NeRF and Ref-NeRF as functions of arrays; the caller decides what is averaged over."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.numerics.volume import sum_before

NOTHING = 1e-35
"""A density that no length makes visible; nothing is divided by less."""

CLEARANCE = 2
"""Lengths of the surface's sample before it, within which nothing counts as fog."""


def charbonnier(error: Float[Array, "..."], width: float) -> Float[Array, "..."]:
    """sqrt(error^2 + width^2): quadratic below `width`, linear above (Mip-NeRF 360)."""
    return jnp.sqrt(error * error + width * width)


def interlevel(target: Float[Array, "rays n"], weights: Float[Array, "rays n"]) -> Float[Array, " rays"]:
    """How far a proposal's weights fall below the final level's blurred ones (Zip-NeRF, section 4)."""
    shortfall = jnp.maximum(jax.lax.stop_gradient(target) - weights, 0.0)
    return jnp.sum(shortfall * shortfall / (weights + 1e-5), -1)


def distortion(
    weights: Float[Array, "rays n"], middle: Float[Array, "rays n"], length: Float[Array, "rays n"]
) -> Float[Array, " rays"]:
    """Spread of the weights along a ray (Mip-NeRF 360, equation 15): sum_ij w_i w_j |m_i - m_j| + sum_i w_i^2 l_i / 3.

    Middles ascend, so the double sum is 2 sum_i w_i (m_i W_i - M_i) with the running sums W of w and M of w m.
    """
    before, moment = sum_before(weights), sum_before(weights * middle)
    pairs = 2 * jnp.sum(weights * (middle * before - moment), -1)
    return pairs + jnp.sum(weights * weights * length, -1) / 3


def hollowness(weights: Float[Array, "rays n"], density: Float[Array, "rays n"]) -> Float[Array, " rays"]:
    """How far the density falls behind what a ray has met: sum_i w_i W_i max(0, 1 - d_i / d_(i-1)), W_i the weights before i.

    What is solid gets no thinner behind its surface: a thin shell over fog shows reflections as well as a surface does, and
    has normals of noise. Ref-NeRF's orientation loss has the same aim and takes a gradient at every sample; this one takes none.
    All but d_i is held, so that the only remedy is to fill what is hollow, never to thin the front.
    """
    before = jnp.pad(density[:, :-1], ((0, 0), (1, 0)))
    met = sum_before(weights)
    held, before = jax.lax.stop_gradient((weights * met, before))
    solid = before > NOTHING
    fall = jnp.where(solid, 1 - density / jnp.where(solid, before, 1.0), 0.0)
    return jnp.sum(held * jnp.maximum(fall, 0.0), -1)


def fog(
    weights: Float[Array, "rays n"], middle: Float[Array, "rays n"], length: Float[Array, "rays n"], surface: Int[Array, " rays"]
) -> Float[Array, " rays"]:
    """Light that is lost before a ray's surface: the sum of the weights that are more than two of its samples' lengths before it.

    Args:
        surface: the column of the surface's sample.
    """
    at = lambda values: jnp.take_along_axis(values, surface[:, None], -1)  # noqa: E731
    before = (length > 0) & (middle < at(middle) - CLEARANCE * at(length))
    return jnp.sum(jnp.where(before, weights, 0.0), -1)


def orientation(normals: Float[Array, "3 n"], viewdirs: Float[Array, "3 n"]) -> Float[Array, " n"]:
    """max(0, n . d)^2: visible normals do not face away from the camera (Ref-NeRF equation 11)."""
    return jnp.square(jnp.maximum(jnp.sum(normals * viewdirs, 0), 0.0))


def normal_difference(normals: Float[Array, "3 n"], normals_pred: Float[Array, "3 n"]) -> Float[Array, " n"]:
    """|n - n'|^2 (Ref-NeRF equation 10)."""
    return jnp.sum(jnp.square(normals - normals_pred), 0)
