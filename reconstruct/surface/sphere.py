"""Surf-NeRF's second pass: the first surface along a ray, and a ball of samples around it.

The supplement's sections A (sphere lattice), B (first surface, radius) and the paper's second forward pass.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from reconstruct.sampling.samples import RaySamples

HALF_WIDTH = float(np.sqrt(2 * np.log(2)))
"""Half-width at half-maximum of a Gaussian, in standard deviations."""


class Surface(eqx.Module):
    """One surface point per chosen ray; everything here is data, no gradient goes through it."""

    ray: Int[Array, " n"]
    """Index of the ray."""
    t: Float[Array, " n"]
    weight: Float[Array, " n"]
    """Volume rendering weight of the surface sample; zero where fewer rays than wanted have a surface."""
    radius: Float[Array, " n"]
    """Half-width of the neighbourhood [scene unit]."""


def first_surface(weights: Float[Array, "rays slots"], valid: Bool[Array, "rays slots"]) -> Int[Array, " rays"]:
    """Slot of the first sample whose weight exceeds the ray's median weight (supplement B).

    An entry exceeds the median exactly where at least half of the ray's entries are smaller: counting
    needs no sort. Where none does (one sample, or all alike) it is the largest.
    """
    smaller = jnp.sum((weights[:, None, :] < weights[:, :, None]) & valid[:, None, :], -1)
    exceeds = valid & (2 * smaller >= jnp.sum(valid, -1, keepdims=True)) & (smaller > 0)
    first = jnp.argmax(exceeds, -1)
    return jnp.where(jnp.any(exceeds, -1), first, jnp.argmax(jnp.where(valid, weights, -1.0), -1))


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
    confidence: float = 0.5,
) -> Surface:
    """Up to `count` rays whose opacity exceeds `confidence`, with their first surface. The others are skipped, not zeroed."""
    weights = jax.lax.stop_gradient(weights)
    opaque = jnp.sum(weights, -1) > confidence
    (ray,) = jnp.nonzero(opaque, size=count, fill_value=0)
    real = jnp.arange(count) < jnp.sum(opaque)
    t, length = samples.padded(samples.t)[ray], samples.padded(samples.length)[ray]
    rows = weights[ray]
    slot = first_surface(rows, length > 0)[:, None]
    pick = lambda table: jnp.take_along_axis(table, slot, -1)[:, 0]  # noqa: E731
    t_mid, t_half = pick(t), pick(length) / 2
    return Surface(
        ray.astype(jnp.int32), t_mid, jnp.where(real, pick(rows), 0.0), neighbourhood_radius(pixel_radius[ray], t_mid, t_half)
    )


def sphere_directions(count: int, kappa: float = 0.0) -> Float[np.ndarray, "count 3"]:
    """Fibonacci-Kronecker lattice of a von Mises-Fisher distribution about the x axis (supplement equations 2-4).

    i runs over 1..count, which keeps |w| <= 1. kappa = 0 is the uniform limit w = 1 - (2 i - 1) / count; below 1e-6 the
    limit is exact to float64.
    """
    i = np.arange(1, count + 1, dtype=np.float64)
    share = (2 * i - 1) / (2 * count)
    w = 1 - 2 * share if kappa < 1e-6 else 1 + np.log1p(share * np.expm1(-2 * kappa)) / kappa
    w = np.clip(w, -1, 1)
    angle = np.pi * (np.sqrt(5) - 1) * i
    across = np.sqrt(1 - w * w)
    return np.stack([w, across * np.cos(angle), across * np.sin(angle)], -1)


def shell_radii(count: int) -> Float[np.ndarray, " count"]:
    """Radii in (0, 1] that put the directions on log2(count) shells (supplement equation 5)."""
    shells = max(int(np.log2(count)), 1)
    return (1 + np.arange(1, count + 1) % shells) / shells


def ball_samples(
    key: PRNGKeyArray, rays: int, count: int, kappa: float, sampling: str
) -> tuple[Float[Array, "rays count 3"], Float[Array, " count"]]:
    """Unit directions from each surface point, turned at random, and their radii in (0, 1].

    "lattice": the Fibonacci-Kronecker lattice on its shells; "fibonacci": the same directions without shells; "random":
    independent uniform directions on the shells.
    """
    radii = jnp.ones(count) if sampling == "fibonacci" else jnp.asarray(shell_radii(count), jnp.float32)
    if sampling == "random":
        drawn = jax.random.normal(key, (rays, count, 3))
        return drawn / jnp.sqrt(jnp.maximum(jnp.sum(drawn**2, -1, keepdims=True), 1e-12)), radii
    lattice = jnp.asarray(sphere_directions(count, kappa), jnp.float32)
    return jnp.einsum("rxy,ny->rnx", random_rotations(key, rays), lattice), radii


def random_rotations(key: PRNGKeyArray, count: int) -> Float[Array, "count 3 3"]:
    """Rotations uniform on SO(3): normalised Gaussian quaternions are uniform on the 3-sphere."""
    q = jax.random.normal(key, (count, 4))
    w, x, y, z = (q / jnp.sqrt(jnp.maximum(jnp.sum(q * q, -1, keepdims=True), 1e-12))).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)
