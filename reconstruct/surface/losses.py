"""Every loss as a function of arrays: no configuration, no model, no reduction over what the caller may want to weight."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

NOTHING = 1e-35
"""A density that no length makes visible; by less than this nothing is divided."""


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
    before = jnp.cumsum(weights, -1) - weights
    moment = jnp.cumsum(weights * middle, -1) - weights * middle
    pairs = 2 * jnp.sum(weights * (middle * before - moment), -1)
    return pairs + jnp.sum(weights * weights * length, -1) / 3


def hollowness(weights: Float[Array, "rays n"], density: Float[Array, "rays n"]) -> Float[Array, " rays"]:
    """How far the density falls behind what a ray has met: sum_i w_i W_i max(0, 1 - d_i / d_(i-1)), W_i the weights before i.

    What is solid gets no thinner behind its surface: a thin shell over fog shows reflections as well as a surface does, and
    has normals of noise. Ref-NeRF's orientation loss says so too, with a gradient at every sample; this needs none. All but d_i is
    held, so that the only remedy is to fill what is hollow, never to thin the front.
    """
    before = jnp.pad(density[:, :-1], ((0, 0), (1, 0)))
    met = jnp.cumsum(weights, -1) - weights
    held, before = jax.lax.stop_gradient((weights * met, before))
    seen = before > NOTHING
    fall = jnp.where(seen, 1 - density / jnp.where(seen, before, 1.0), 0.0)
    return jnp.sum(held * jnp.maximum(fall, 0.0), -1)


def orientation(normals: Float[Array, "3 n"], viewdirs: Float[Array, "3 n"]) -> Float[Array, " n"]:
    """max(0, n . d)^2: visible normals do not face away from the camera (Ref-NeRF equation 11)."""
    return jnp.square(jnp.maximum(jnp.sum(normals * viewdirs, 0), 0.0))


def normal_difference(normals: Float[Array, "3 n"], normals_pred: Float[Array, "3 n"]) -> Float[Array, " n"]:
    """|n - n'|^2 (Ref-NeRF equation 10)."""
    return jnp.sum(jnp.square(normals - normals_pred), 0)


def density_smoothness(
    density: Float[Array, "rays n"],
    offsets: Float[Array, "rays n 3"],
    normals: Float[Array, "rays 3"],
    radius: Float[Array, " rays"],
    form: str,
) -> Float[Array, " rays"]:
    """Density around a surface point belongs into its tangent plane.

    With alpha = 1 - exp(-density * radius), free of the scene's scale, and r the unit offset of a sample:
    "tangent": alpha |r . n|, which vanishes in the plane; "published": alpha |1 - r . n|, as the published
    implementation has it.
    """
    alpha = -jnp.expm1(-jnp.minimum(density * radius[:, None], 80.0))
    along = jnp.einsum("rnx,rx->rn", offsets, normals)
    return jnp.mean(alpha * jnp.abs(along if form == "tangent" else 1 - along), -1)


def normal_consistency(normals: Float[Array, "rays n 3"], surface_normal: Float[Array, "rays 3"]) -> Float[Array, " rays"]:
    """Mean of (1 - |n_i . n|) / 2 over the samples around a surface point."""
    return jnp.mean((1 - jnp.abs(jnp.einsum("rnx,rx->rn", normals, surface_normal))) / 2, -1)


def lambertian_bias(specular: Float[Array, "rays n 3"]) -> Float[Array, " rays"]:
    """What stays constant in the specular colour belongs to the diffuse one: its magnitude, relative to its maximum.

    The maximum over directions and channels is held constant (supplement C).
    """
    largest = jax.lax.stop_gradient(jnp.max(specular, axis=(1, 2), keepdims=True))
    return jnp.mean(jnp.sum(jnp.square(specular / jnp.maximum(largest, 1e-4)), -1), -1)


def direction_likeness(directions: Float[Array, "rays n 3"], form: str) -> Float[Array, "rays n n"]:
    """How near directions are to each other, in [-1, 1], as data: neighbours in a graph are those of the largest.

    "angular": the cosine of the angle between them; "published": the cosine between their triples of polar angle, azimuth and
    length, as the published implementation has it, which tears the sphere along a meridian and stretches its poles.
    """
    held = jax.lax.stop_gradient(directions)
    if form == "published":
        x, y, z = jnp.moveaxis(held, -1, 0)
        held = jnp.stack([jnp.arctan2(jnp.sqrt(x * x + y * y), z), jnp.arctan2(y, x), jnp.ones_like(z)], -1)
        held = held / jnp.sqrt(jnp.sum(held * held, -1, keepdims=True))  # at least 1 long: the unit length is one of the three
    return jnp.einsum("rix,rjx->rij", held, held)


def specular_variation(
    specular: Float[Array, "rays n 3"], likeness: Float[Array, "rays n n"], neighbours: int
) -> Float[Array, " rays"]:
    """Graph total variation over directions (supplement D): mean |c_i - c_j| over the nearest j by `likeness`.

    Gradients go to the sample and not to its neighbours. The nearest are found by repeated maximum, which for a handful beats
    a sort.
    """
    count = likeness.shape[1]
    likeness = likeness - 4 * jnp.eye(count, dtype=likeness.dtype)
    held = jax.lax.stop_gradient(specular)
    total = jnp.zeros(specular.shape[0], specular.dtype)
    for _ in range(min(neighbours, count - 1)):
        nearest = jnp.argmax(likeness, -1)
        other = jnp.take_along_axis(held, nearest[..., None], 1)
        total = total + jnp.mean(jnp.sum(jnp.abs(specular - other), -1), -1)
        likeness = likeness - 4 * jax.nn.one_hot(nearest, count, dtype=likeness.dtype)
    return total / max(min(neighbours, count - 1), 1)
