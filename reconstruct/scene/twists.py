"""Corrections of camera poses as twists, and what they do to rays.

A twist is a translation t [scene unit], then a rotation vector w [rad], both along the scene's axes: a perturbation from the
left about the camera's own centre o, so that a rotation turns the camera on the spot:

    x' = o + Exp(w) (x - o) + V(w) t,    Exp(w) = I + a W + b W^2,  V(w) = I + b W + c W^2,    W v = w x v,
    a = sin(s) / s,  b = (1 - cos(s)) / s^2,  c = (s - sin(s)) / s^3,  s = |w|.

All views of a session in which the object lay otherwise have one motion: six numbers, see `Session`. As the twist of one motion
about another place changes with the place linearly, each view's twist is a matrix times these numbers, exactly.

Pictures cannot tell a correction that moves, turns or scales all cameras alike from none (the gauge): seven directions of the
views' twists together. Corrections are kept free of them, so that the scene stays where the given poses put it.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from koala3d.reconstruct.scene.rays import Rays

Twists = Float[Array, "*n 6"]

SERIES_BELOW = 0.25
"""Squared angles below this take the series, whose first term left out is then 1e-8 of the sum."""
DEPENDENT = 1e-3
"""A direction of the gauge that has less than this of its length beside the others is one of them."""


class Session(eqx.Module):
    """How the views of a second session move together: those of an object that was turned over."""

    spread: Float[Array, "views 6 6"]
    """From `by` to each view's twist; see `together`. Zero for views of the first session, which stay."""
    by: Float[Array, " 6"]
    """In standard deviations of the motion as it was stated, along the axes of its covariance."""

    @property
    def twists(self) -> Float[Array, "views 6"]:
        """Of each training view."""
        return self.spread @ self.by


def together(
    origins: Float[np.ndarray, "views 3"], middle: Float[np.ndarray, " 3"], covariance: Float[np.ndarray, "6 6"]
) -> Float[np.ndarray, "views 6 6"]:
    """Of cameras at `origins` that move as one: from six standard normal numbers to each one's twist.

    Args:
        covariance: of a shift of `middle` and a turn about it, in the units of twists.
    """
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(values, 0))
    x, y, z = (np.asarray(origins, np.float64) - middle).T
    zero = np.zeros_like(x)
    across = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], -1).reshape(-1, 3, 3)  # across @ w = w x (origin - middle)
    shift = root[:3] + across @ root[3:]
    return np.concatenate([shift, np.broadcast_to(root[3:], shift.shape)], 1)


def moved(rays: Rays, twists: Twists | None) -> Rays:
    """Rays as the corrected cameras see them; those given where there are no corrections.

    Args:
        twists: (views, 6), by the rays' view.
    """
    if twists is None:
        return rays
    twist = twists.at[rays.view].get(mode="promise_in_bounds")
    shift, turn = twist[:, :3], twist[:, 3:]
    a, b, c = (factor[:, None] for factor in _factors(jnp.sum(turn * turn, -1)))
    turned = _both(turn, rays.directions)
    shifted = _both(turn, shift)
    origins = rays.origins + (shift + b * shifted[0] + c * shifted[1])
    directions = rays.directions + (a * turned[0] + b * turned[1])
    return eqx.tree_at(lambda r: (r.origins, r.directions), rays, (origins, directions))


def followed(rays: Rays, twists: Twists | None) -> Rays:
    """The same rays, with a gradient to the twists by which they were moved already.

    The gradient is that of a further twist from the left, which differs from the twists' own by a share of half their angle:
    thousandths.
    """
    return rays if twists is None else moved(rays, twists - jax.lax.stop_gradient(twists))


def _factors(squared: Float[Array, " n"]) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """a, b and c of the squared angle s^2; the branch not taken has a harmless operand."""
    near = squared < SERIES_BELOW
    safe = jnp.where(near, 1.0, squared)
    angle = jnp.sqrt(safe)
    sine, half = jnp.sin(angle), jnp.sin(angle / 2)
    a = jnp.where(near, 1 - squared / 6 * (1 - squared / 20 * (1 - squared / 42)), sine / angle)
    b = jnp.where(near, 0.5 - squared / 24 * (1 - squared / 30 * (1 - squared / 56)), 2 * half * half / safe)
    c = jnp.where(near, 1 / 6 - squared / 120 * (1 - squared / 42 * (1 - squared / 72)), (angle - sine) / (safe * angle))
    return a, b, c


def _both(turn: Float[Array, "n 3"], vectors: Float[Array, "n 3"]) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """W v and W^2 v."""
    once = jnp.cross(turn, vectors)
    return once, jnp.cross(turn, once)


def gauge(origins: Float[Array, "views 3"], sigma: Float[Array, " 6"]) -> list[Float[Array, "views 6"]]:
    """Orthonormal twists, in units of `sigma`, that move, turn or scale cameras at `origins` as one; at most seven.

    Gram and Schmidt's method, twice, with zeros for what depends on the others: a few sums, on any device.
    """
    local = origins - jnp.mean(origins, 0)
    still, axes = jnp.zeros_like(local), jnp.eye(3)
    raw = [(jnp.broadcast_to(axis, local.shape), still) for axis in axes]
    raw += [(jnp.cross(axis[None], local), jnp.broadcast_to(axis, local.shape)) for axis in axes]
    raw += [(local, still)]
    basis: list[Array] = []
    for shift, turn in raw:
        column = _unit(jnp.concatenate([shift, turn], -1) / sigma, 0.0)
        for _ in range(2):
            column = column - sum((jnp.sum(column * other) * other for other in basis), jnp.zeros_like(column))
        basis.append(_unit(column, DEPENDENT))
    return basis


def without_gauge(
    values: Float[Array, "views 6"], origins: Float[Array, "views 3"], sigma: Float[Array, " 6"]
) -> Float[Array, "views 6"]:
    """Twists in units of `sigma` without their part in the gauge."""
    return values - sum((jnp.sum(values * one) * one for one in gauge(origins, sigma)), jnp.zeros_like(values))


def _unit(column: Float[Array, "views 6"], shortest: float) -> Float[Array, "views 6"]:
    """Of length one; zero where it is no longer than `shortest`."""
    length = jnp.sqrt(jnp.sum(column * column))
    return jnp.where(length > shortest, column / jnp.where(length > shortest, length, 1.0), 0.0)
