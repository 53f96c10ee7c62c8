"""Elementary functions whose value and gradient are finite everywhere, by construction.

Each gives `where` a harmless operand before it divides or takes a root, so that the branch not taken
cannot put a NaN into the gradient.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

MAX_EXPONENT = 15.0
"""Arguments of `safe_exp` are clipped here: exp(15) = 3.3e6, opaque at any step length that is used."""


@jax.custom_jvp
def safe_exp(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """exp(min(x, 15)); the derivative is the value itself, so that a saturated density can still fall."""
    return jnp.exp(jnp.minimum(x, MAX_EXPONENT))


@safe_exp.defjvp
def _safe_exp_jvp(primals, tangents):
    value = safe_exp(*primals)
    return value, value * tangents[0]


def safe_norm(x: Float[Array, "*shape n"], axis: int = -1) -> Float[Array, "..."]:
    """Euclidean norm with gradient zero at the origin; squares neither overflow nor vanish."""
    largest, scaled = _by_largest(x, axis)
    squared = jnp.sum(scaled * scaled, axis=axis)
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0) * jnp.squeeze(largest, axis)


def normalise(x: Float[Array, "*shape"], axis: int = -1, floor: float = 1e-12) -> Float[Array, "*shape"]:
    """x / |x|; vectors shorter than `floor` are divided by `floor`, so that zero stays zero.

    These have no direction, and no gradient either: that of the division, 1 / floor, would outgrow float32 where one
    normalisation follows another.
    """
    largest, scaled = _by_largest(x, axis)
    squared = jnp.sum(scaled * scaled, axis=axis, keepdims=True)
    usable = largest * jnp.sqrt(jax.lax.stop_gradient(squared)) > floor
    length = jnp.sqrt(jnp.where(usable, squared, 1.0))
    return jnp.where(usable, scaled / length, jax.lax.stop_gradient(x) / floor)


def _by_largest(x: Array, axis: int) -> tuple[Array, Array]:
    """Size of the largest component of each vector, held constant (1 where that is next to nothing), and the vectors over it."""
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(x), axis=axis, keepdims=True))
    largest = jnp.where(largest > 1e-30, largest, 1.0)
    return largest, x / largest


def srgb_from_linear(linear: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """IEC 61966-2-1 transfer curve of values >= 0; linear below 0.0031308, where the power's slope would grow."""
    above = linear > 0.0031308
    power = jnp.power(jnp.where(above, linear, 1.0), 1.0 / 2.4)
    return jnp.where(above, 1.055 * power - 0.055, 12.92 * linear)


def linear_from_srgb(srgb: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Inverse of `srgb_from_linear`, for values >= 0."""
    above = srgb > 0.04045
    power = jnp.power((jnp.where(above, srgb, 1.0) + 0.055) / 1.055, 2.4)
    return jnp.where(above, power, srgb / 12.92)
