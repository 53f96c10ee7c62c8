"""Places at which a field is evaluated: points, or frustums that several small Gaussians stand for.

Knows the space, so that fields see its coordinates and everybody else the scene's own.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.field.encodings.encoding import Encoding, Scale
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Space

GAUSSIAN_SCALE = 0.5
"""Zip-NeRF's factor on the width of the Gaussians."""


class Cloud(eqx.Module):
    """n places of `group` consecutive Gaussians each, whose features are averaged."""

    points: Float[Array, "3 n_group"]
    """Scene coordinates."""
    scale: Float[Array, " n_group"] | Float[Array, "3 n_group"] | None
    """Standard deviation, of all axes or of each [scene unit]; None for points without extent."""
    space: Space = eqx.field(static=True)
    group: int = eqx.field(static=True, default=1)
    followed: bool = eqx.field(static=True, default=False)
    """Whether a gradient goes to the points: they are data elsewhere."""

    def of(self, chosen: Int[Array, " m"]) -> "Cloud":
        """Some of the places, by their indices."""
        pick = lambda v: v.reshape(*v.shape[:-1], -1, self.group)[..., chosen, :].reshape(*v.shape[:-1], -1)  # noqa: E731
        return replace(self, points=pick(self.points), scale=None if self.scale is None else pick(self.scale))

    def joined(self, other: "Cloud") -> "Cloud":
        """These places, then others of the same kind."""
        scale = None if self.scale is None or other.scale is None else jnp.concatenate([self.scale, other.scale], -1)
        return replace(self, points=jnp.concatenate([self.points, other.points], -1), scale=scale)

    def encoded(self, encoding: Encoding) -> Float[Array, "channels n"]:
        """Features of each place."""
        points, scale = barrier(self.mapped())
        if not self.followed:
            return self._averaged(encoding(points, scale))
        held = jax.lax.stop_gradient(points)
        features, jacobian = encoding.value_and_jacobian(held, scale)
        slopes = jax.lax.stop_gradient(jacobian)
        return self._averaged(features + jnp.einsum("cxn,xn->cn", slopes, points - held))  # adds nothing but a gradient

    def encoded_with_jacobian(self, encoding: Encoding) -> tuple[Float[Array, "channels n"], Float[Array, "channels 3 n_group"]]:
        """Features of each place, and of each Gaussian the features' derivative to the encoding's coordinates."""
        features, jacobian = encoding.value_and_jacobian(*barrier(self.mapped()))
        return self._averaged(features), jacobian

    def gradient(
        self, sensitivity: Float[Array, "channels n"], jacobian: Float[Array, "channels 3 n_group"]
    ) -> Float[Array, "3 n"]:
        """Derivative to the scene's coordinates of what has these derivatives to each place's features.

        Args:
            jacobian: of `encoded_with_jacobian`.
        """
        along = jnp.sum(jnp.repeat(sensitivity, self.group, axis=1)[:, None] * jacobian, 0)
        return self._averaged(along if self.space.bounded else self.space.pull_back(self.points.T, along.T).T)

    def centres(self) -> Float[Array, "3 n"]:
        """Where each place is around the object: the mean of its Gaussians'."""
        return self._averaged(self.points if self.space.bounded else self.space.around(self.points.T).T)

    def mapped(self) -> tuple[Float[Array, "3 n_group"], Scale | None]:
        """Points and scale as the encodings take them."""
        if self.space.bounded:
            return self.points, self.scale
        factor = None if self.scale is None else self.scale * self.space.scale(self.points.T)
        return self.space.mapped(self.points.T).T, factor

    def _averaged(self, values: Float[Array, "*lead n_group"]) -> Float[Array, "*lead n"]:
        if self.group == 1:
            return values
        return values.reshape(*values.shape[:-1], -1, self.group).mean(-1)


def points_on_rays(rays: Rays, ray: Array, t: Float[Array, " n"], space: Space) -> Cloud:
    """Points at distance t along the given rays."""
    along = rays.directions.at[ray].get(mode="promise_in_bounds") * t[:, None]
    return Cloud((rays.origins.at[ray].get(mode="promise_in_bounds") + along).T, None, space)


def gaussians_in_frustums(rays: Rays, ray: Array, t: Float[Array, " n"], half: Float[Array, " n"], space: Space) -> Cloud:
    """One Gaussian per conical frustum, of its mean and the diagonal of its covariance (Mip-NeRF, equations 7 to 16).

    Args:
        ray: index of each frustum's ray.
        t: middle of the frustum, `half` its half length, both in multiples of the ray's direction.
    """
    get = lambda a: a.at[ray].get(mode="promise_in_bounds")  # noqa: E731
    directions, radius = get(rays.directions), get(rays.radii)
    share = half**2 / jnp.maximum(3 * t**2 + half**2, 1e-30)  # higher powers have no room
    mean = t + 2 * t * share
    along = half**2 / 3 - (4 / 15) * share**2 * (12 * t**2 - half**2)
    across = radius**2 * (t**2 / 4 + half**2 * (5 / 12 - (4 / 15) * share))
    squared = directions**2
    axial = squared / jnp.maximum(jnp.sum(squared, -1, keepdims=True), 1e-12)
    variance = jnp.maximum(along, 0.0)[:, None] * squared + jnp.maximum(across, 0.0)[:, None] * (1 - axial)
    points = get(rays.origins) + mean[:, None] * directions
    return Cloud(points.T, jnp.sqrt(jnp.maximum(variance, 1e-16)).T, space)


def hexagons_in_frustums(rays: Rays, tdist: Float[Array, "rays edges"], turn: Float[Array, " rays"], space: Space) -> Cloud:
    """Six Gaussians per conical frustum that match its mean and covariance (Zip-NeRF, section 3.1).

    Args:
        turn: angle by which each ray's hexagons are turned about it [rad].
    """
    t0, t1 = tdist[:, :-1, None], tdist[:, 1:, None]
    middle, half = (t0 + t1) / 2, (t1 - t0) / 2
    j = jnp.asarray(2 * np.arange(6) / 5 - 1, jnp.float32) * np.float32(3 / np.sqrt(7))
    spread = jnp.sqrt((half**2 - middle**2) ** 2 + 4 * middle**4)
    t = t0 + half * (t1**2 + 2 * middle**2 + j * spread) / jnp.maximum(half**2 + 3 * middle**2, 1e-12)
    angle = jnp.asarray(np.pi * np.array([0, 2 / 3, 4 / 3, 1, 5 / 3, 1 / 3]), jnp.float32) + turn[:, None, None]
    across, up = _perpendicular(rays.viewdirs)
    radius = rays.radii[:, None, None] * t / np.float32(np.sqrt(2))
    offset = radius[..., None] * (
        jnp.cos(angle)[..., None] * across[:, None, None] + jnp.sin(angle)[..., None] * up[:, None, None]
    )
    points = rays.origins[:, None, None] + t[..., None] * rays.directions[:, None, None] + offset
    return Cloud(points.reshape(-1, 3).T, (GAUSSIAN_SCALE * radius).reshape(-1), space, group=6)


def _perpendicular(viewdirs: Float[Array, "n 3"]) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Two unit vectors across each view direction (Duff et al. 2017), continuous but at z = 0."""
    x, y, z = viewdirs.T
    sign = jnp.where(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    return (jnp.stack([1 + sign * x * x * a, sign * b, -sign * x], -1), jnp.stack([b, sign + y * y * a, -y], -1))
