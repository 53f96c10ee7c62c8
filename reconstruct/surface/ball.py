"""A ball of samples around a surface point: directions on a lattice, shells, and a random rotation (supplement A)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from koala3d.reconstruct.config import SurfaceConfig


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
    key: PRNGKeyArray, rays: int, ball: SurfaceConfig
) -> tuple[Float[Array, "rays count 3"], Float[Array, " count"]]:
    """Unit directions from each surface point, turned at random, and their radii in (0, 1]."""
    count = ball.samples
    radii = jnp.ones(count) if ball.sampling == "fibonacci" else jnp.asarray(shell_radii(count), jnp.float32)
    if ball.sampling == "random":
        drawn = jax.random.normal(key, (rays, count, 3))
        return drawn / jnp.sqrt(jnp.maximum(jnp.sum(drawn**2, -1, keepdims=True), 1e-12)), radii
    lattice = jnp.asarray(sphere_directions(count), jnp.float32)
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
