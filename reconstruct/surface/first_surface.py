"""The first surface along a ray, and how wide its pixel's footprint is there (supplement B and equation 7)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from koala3d.reconstruct.sampling.samples import RaySamples

HALF_WIDTH = float(np.sqrt(2 * np.log(2)))
"""Half-width at half-maximum of a Gaussian, in standard deviations."""
GOLDEN = (np.sqrt(5) - 1) / 2
"""Multiples of it, less their whole part, are spread evenly over [0, 1), however many there are."""
LEAST_OPACITY = 0.5
"""Opacity above which a ray has a surface."""
SHARE = 0.5
"""Of the largest weight, for the rule "share"."""


class Surface(eqx.Module):
    """One surface point per chosen ray; everything here is data, no gradient goes through it."""

    ray: Int[Array, " n"]
    """Index of the ray."""
    t: Float[Array, " n"]
    weight: Float[Array, " n"]
    """Volume rendering weight of the surface sample; zero where fewer rays than wanted have a surface."""
    radius: Float[Array, " n"]
    """Half-width of the neighbourhood [scene unit]."""

    def mean(self, values: Float[Array, " n"]) -> Float[Array, ""]:
        """Of values at the points, each counted by its weight."""
        return jnp.sum(self.weight * values) / jnp.maximum(jnp.sum(self.weight > 0), 1)


class Surfaces(eqx.Module):
    """The surface points of the same rays by two rules."""

    first: Surface
    """By the configured rule: where the shape is regularised."""
    solid: Surface
    """By the rule "share": where a colour is the surface's and not that of fog before it."""

    def of_rays(self, count: int) -> "Surfaces":
        """Those of the first rays."""
        return jax.tree.map(lambda values: values[:count], self)

    def settled(self, share: Float[Array, ""], at_object: Bool[Array, " n"]) -> "Surfaces":
        """With `solid` in place of `first` on this share of the rays at the object, which are spread evenly over all rays."""
        those = at_object & (jnp.arange(self.first.t.shape[0]) * GOLDEN % 1 < share)
        chosen = jax.tree.map(lambda solid, first: jnp.where(those, solid, first), self.solid, self.first)
        return Surfaces(chosen, self.solid)


def first_surface(
    weights: Float[Array, "rays slots"], valid: Bool[Array, "rays slots"], rule: str = "median"
) -> Int[Array, " rays"]:
    """Slot of the first surface; of the largest weight where the rule finds none.

    Args:
        rule: "median": the first weight above the ray's median (supplement B); "share": the first of at least `SHARE` of the
            largest.
    """
    found = RULES[rule](weights, valid)
    return jnp.where(jnp.any(found, -1), jnp.argmax(found, -1), jnp.argmax(jnp.where(valid, weights, -1.0), -1))


def _above_median(weights: Float[Array, "rays slots"], valid: Bool[Array, "rays slots"]) -> Bool[Array, "rays slots"]:
    """An entry exceeds the median exactly where at least half of the ray's entries are smaller: counting needs no sort."""
    smaller = jnp.sum((weights[:, None, :] < weights[:, :, None]) & valid[:, None, :], -1)
    return valid & (2 * smaller >= jnp.sum(valid, -1, keepdims=True)) & (smaller > 0)


def _of_the_largest(weights: Float[Array, "rays slots"], valid: Bool[Array, "rays slots"]) -> Bool[Array, "rays slots"]:
    return valid & (weights >= SHARE * jnp.max(jnp.where(valid, weights, 0.0), -1, keepdims=True))


RULES = {"median": _above_median, "share": _of_the_largest}
"""Which slots may be the first surface: it is the first of them."""


def neighbourhood_radius(
    pixel_radius: Float[Array, " n"], t_mid: Float[Array, " n"], t_half: Float[Array, " n"]
) -> Float[Array, " n"]:
    """Half-width of the conical frustum across the ray (Mip-NeRF equation 7, supplement equation 7).

        sigma_r^2 = r^2 (t_mid^2 / 4 + 5 t_half^2 / 12 - 4 t_half^4 / (15 (3 t_mid^2 + t_half^2)))

    scaled to the half-width at half-maximum; r t_mid / 2 times that as t_half goes to zero.
    """
    denominator = 15 * (3 * t_mid**2 + t_half**2)
    last = 4 * t_half**2 * (t_half**2 / jnp.where(denominator > 0, denominator, 1.0))  # the fourth power has no room
    variance = t_mid**2 / 4 + 5 * t_half**2 / 12 - last
    return HALF_WIDTH * pixel_radius * jnp.sqrt(jnp.maximum(variance, 0.0))


def find_surfaces(
    weights: Float[Array, "rays slots"],
    samples: RaySamples,
    pixel_radius: Float[Array, " rays"],
    count: int,
    rule: str = "median",
) -> Surface:
    """First surfaces of up to `count` rays that are opaque enough. Other rays are skipped, not multiplied by zero.

    Args:
        rule: see `first_surface`.
    """
    weights = jax.lax.stop_gradient(weights)
    has_surface = jnp.sum(weights, -1) > LEAST_OPACITY
    (ray,) = jnp.nonzero(has_surface, size=count, fill_value=0)
    real = jnp.arange(count) < jnp.sum(has_surface)
    t, length = samples.padded(samples.t)[ray], samples.padded(samples.length)[ray]
    rows = weights[ray]
    slot = first_surface(rows, length > 0, rule)[:, None]
    pick = lambda table: jnp.take_along_axis(table, slot, -1)[:, 0]  # noqa: E731
    t_mid, t_half = pick(t), pick(length) / 2
    return Surface(
        ray.astype(jnp.int32), t_mid, jnp.where(real, pick(rows), 0.0), neighbourhood_radius(pixel_radius[ray], t_mid, t_half)
    )
