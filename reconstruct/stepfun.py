"""Step functions along rays: histograms over sorted edges.

Vocabulary: t, edges (n + 1, ascending); w, the weight of an interval (n, summing to at most one over the ray); p, its
density w / (t[1:] - t[:-1]). All arrays are (..., n) with rays in front.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def power_ladder(x: Float[Array, "..."], power: float, premultiplier: float = 1.0) -> Float[Array, "..."]:
    """Curve from the linear to the logarithmic and beyond (Zip-NeRF supplement, equation 3), for x >= 0, power < 1, not 0.

        |p - 1| / p * ((x / |p - 1| + 1)^p - 1)
    """
    scale = abs(power - 1)
    return scale / power * (jnp.power(x * premultiplier / scale + 1, power) - 1)


def inverse_power_ladder(y: Float[Array, "..."], power: float, premultiplier: float = 1.0) -> Float[Array, "..."]:
    """Inverse of `power_ladder`; beyond the ladder's end the argument is clipped just below it."""
    scale = abs(power - 1)
    base = jnp.maximum(y * power / scale + 1, 1e-12)
    return scale * (jnp.power(base, 1 / power) - 1) / premultiplier


def sample_intervals(
    uniforms: Float[Array, " rays"], t: Float[Array, "rays n+1"], w: Float[Array, "rays n"], count: int
) -> Float[Array, "rays count+1"]:
    """`count` intervals of equal probability: edges halfway between stratified draws, one jitter per ray.

    Inverse of the piecewise linear distribution function; where all weights are zero, it is that of the edges'
    own spacing, so that the result is always ascending and inside [t[0], t[-1]].

    Args:
        uniforms: one number in [0, 1) per ray.
        t: edges. w: weights >= 0. No gradient is wanted through either (stop it outside).
    """
    span = t[..., 1:] - t[..., :-1]
    total = jnp.sum(w, -1, keepdims=True)
    fallback = span / jnp.maximum(jnp.sum(span, -1, keepdims=True), 1e-30)
    share = jnp.where(total > 1e-12, w / jnp.where(total > 1e-12, total, 1.0), fallback)
    cdf = jnp.concatenate([jnp.zeros_like(share[..., :1]), jnp.cumsum(share, -1)[..., :-1].clip(0, 1), jnp.ones_like(share[..., :1])], -1)
    u = (jnp.arange(count) + uniforms[:, None]) / count
    centres = jax.vmap(jnp.interp)(u, cdf, t)
    middle = (centres[..., 1:] + centres[..., :-1]) / 2
    first = jnp.maximum(2 * centres[..., :1] - middle[..., :1], t[..., :1])
    last = jnp.minimum(2 * centres[..., -1:] - middle[..., -1:], t[..., -1:])
    return jnp.concatenate([first, middle, last], -1)


def blur(t: Float[Array, "rays n+1"], p: Float[Array, "rays n"], half_width: float) -> tuple[Float[Array, "rays m"], Float[Array, "rays m"]]:
    """Convolve the densities p with a box of `half_width`: a piecewise linear function (Zip-NeRF, section 4).

    Returns:
        (edges, values) with m = 2 (n + 1): the function is linear between them and zero outside.
    """
    edges = jnp.concatenate([t - half_width, t + half_width], -1)
    order = jnp.argsort(edges, -1)
    edges = jnp.take_along_axis(edges, order, -1)
    zero = jnp.zeros_like(p[..., :1])
    jump = (jnp.concatenate([p, zero], -1) - jnp.concatenate([zero, p], -1)) / (2 * half_width)
    slopes = jnp.take_along_axis(jnp.concatenate([jump, -jump], -1), order, -1)
    rise = jnp.cumsum(slopes, -1)[..., :-1] * (edges[..., 1:] - edges[..., :-1])
    values = jnp.concatenate([jnp.zeros_like(rise[..., :1]), jnp.cumsum(rise, -1)], -1)
    return edges, jnp.maximum(values, 0.0)


def resample_blurred(
    query: Float[Array, "rays k+1"], t: Float[Array, "rays n+1"], w: Float[Array, "rays n"], half_width: float
) -> Float[Array, "rays k"]:
    """Weights that the blurred histogram (t, w) puts into the intervals of `query`: the interlevel loss's target."""
    p = w / jnp.maximum(t[..., 1:] - t[..., :-1], 1e-8)
    edges, values = blur(t, p, half_width)
    area = jnp.concatenate([jnp.zeros_like(values[..., :1]), jnp.cumsum((values[..., 1:] + values[..., :-1]) / 2 * jnp.diff(edges, axis=-1), -1)], -1)
    index = jax.vmap(lambda e, q: jnp.searchsorted(e, q, side="right"))(edges, query) - 1
    index = jnp.clip(index, 0, edges.shape[-1] - 2)
    take = lambda a, i: jnp.take_along_axis(a, i, -1)  # noqa: E731
    left, right = take(edges, index), take(edges, index + 1)
    offset = jnp.clip(query, edges[..., :1], edges[..., -1:]) - left
    width = jnp.maximum(right - left, 1e-12)
    slope = (take(values, index + 1) - take(values, index)) / width
    integral = take(area, index) + offset * (take(values, index) + slope * offset / 2)
    return jnp.maximum(jnp.diff(integral, axis=-1), 0.0)
