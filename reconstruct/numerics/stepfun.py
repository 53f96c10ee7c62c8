"""Step functions along rays: histograms over sorted edges.

Vocabulary: t, edges (n + 1, ascending); w, the weight of an interval (n, summing to at most one over the ray); p, its
density w / (t[1:] - t[:-1]). All arrays are (..., n) with rays in front.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def power_ladder(x: Float[Array, "..."], power: float, premultiplier: float = 1.0) -> Float[Array, "..."]:
    """Curve from the linear to the logarithmic and beyond (Zip-NeRF supplement, equation 3), for x >= 0, power < 1, not 0.

        |p - 1| / p * ((m x / |p - 1| + 1)^p - 1),   m the premultiplier,

    with the power as expm1 of a multiple of log1p, which keeps the digits of small x.
    """
    scale = abs(power - 1)
    return scale / power * jnp.expm1(power * jnp.log1p(x * premultiplier / scale))


def inverse_power_ladder(y: Float[Array, "..."], power: float, premultiplier: float = 1.0) -> Float[Array, "..."]:
    """Inverse of `power_ladder`; beyond the ladder's end the argument is clipped just below it."""
    scale = abs(power - 1)
    less_one = jnp.maximum(y * power / scale, 1e-7 - 1)
    return scale * jnp.expm1(jnp.log1p(less_one) / power) / premultiplier


def sample_intervals(
    uniforms: Float[Array, " rays"], t: Float[Array, "rays edges"], w: Float[Array, "rays n"], count: int
) -> Float[Array, "rays {count}+1"]:
    """`count` intervals of equal probability: edges halfway between stratified draws, one jitter per ray.

    Inverse of the piecewise linear distribution function; where all weights are zero, it is that of the edges'
    own spacing, so that the result is always ascending and inside [t[0], t[-1]].

    Args:
        uniforms: one number in [0, 1) per ray.
        t: edges. w: weights >= 0. No gradient goes through either: where samples lie is data.
    """
    t, w = jax.lax.stop_gradient((t, w))
    span = t[..., 1:] - t[..., :-1]
    total = jnp.sum(w, -1, keepdims=True)
    fallback = span / jnp.maximum(jnp.sum(span, -1, keepdims=True), 1e-30)
    share = jnp.where(total > 1e-12, w / jnp.where(total > 1e-12, total, 1.0), fallback)
    cdf = jnp.concatenate(
        [jnp.zeros_like(share[..., :1]), jnp.cumsum(share, -1)[..., :-1].clip(0, 1), jnp.ones_like(share[..., :1])], -1
    )
    u = (jnp.arange(count) + uniforms[:, None]) / count
    centres = jax.vmap(jnp.interp)(u, cdf, t)
    middle = (centres[..., 1:] + centres[..., :-1]) / 2
    first = jnp.maximum(2 * centres[..., :1] - middle[..., :1], t[..., :1])
    last = jnp.minimum(2 * centres[..., -1:] - middle[..., -1:], t[..., -1:])
    return jnp.concatenate([first, middle, last], -1)


def sum_of_boxes_cdf(x: Float[Array, "..."], first: Float[Array, "..."], second: float) -> Float[Array, "..."]:
    """Distribution function at x of the sum of two centred uniform variables of widths `first` >= 0 and `second` > 0.

    Differences are taken between numbers of the size of the wider box, so that the narrow box may shrink to nothing.
    """
    wide, narrow = jnp.maximum(first, second), jnp.minimum(first, second)
    x = jnp.clip(x, -(wide + narrow) / 2, (wide + narrow) / 2)

    def ramp(y):
        curved = jnp.square(y + narrow / 2) / jnp.where(narrow > 0, 2 * narrow, 1.0)
        return jnp.where((jnp.abs(y) < narrow / 2), curved, jnp.maximum(y, 0.0))

    return (ramp(x + wide / 2) - ramp(x - wide / 2)) / wide


def resample_blurred(
    query: Float[Array, "rays query_edges"], t: Float[Array, "rays edges"], w: Float[Array, "rays n"], half_width: float
) -> Float[Array, "rays query_edges-1"]:
    """Weights that the histogram (t, w), blurred by a box of `half_width`, puts into the intervals of `query`.

    The interlevel loss's target (Zip-NeRF, Barron et al. 2023, section 4). An interval blurred by a box is the sum of two
    uniform variables, whose distribution function is taken at every edge of `query`. Integrating the blurred
    density's slopes instead, as the paper does, is the same in exact arithmetic, but in float32 the slopes of narrow
    intervals cancel so badly that a third of the weight can get lost.
    """
    middle, width = (t[..., 1:] + t[..., :-1]) / 2, t[..., 1:] - t[..., :-1]
    below = sum_of_boxes_cdf(query[..., :, None] - middle[..., None, :], width[..., None, :], 2 * half_width)
    return jnp.maximum(jnp.diff(jnp.sum(w[..., None, :] * below, -1), axis=-1), 0.0)
