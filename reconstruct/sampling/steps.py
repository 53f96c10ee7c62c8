"""How rays are cut into steps."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Space

FRONT, BEHIND = 32, 64
"""Steps between the near plane and the object's ball, and from there to the far plane, where there are surroundings."""


class Steps(eqx.Module):
    """How rays are cut into steps: `at(u)` gives t at step coordinate u in [0, count], per ray monotonic."""

    near: Float[Array, " n"]
    enter: Float[Array, " n"]
    leave: Float[Array, " n"]
    far: Float[Array, " n"]
    front: int = eqx.field(static=True)
    inside: int = eqx.field(static=True)
    behind: int = eqx.field(static=True)

    @classmethod
    def of(
        cls, rays: Rays, *, steps: int, space: Space, near: float | Float[Array, ""], far: float | Float[Array, ""]
    ) -> "Steps":
        """Even steps through the object's cube or unit ball, with front and background around the ball; even in disparity
        where cameras share a frustum."""
        if isinstance(space, Frustum):
            first, last = jnp.full_like(rays.radii, near), jnp.full_like(rays.radii, far)
            return cls(first, first, first, last, 0, 0, steps)
        if space.bounded:
            enter, leave = box_interval(rays)
            enter = jnp.maximum(enter, near)
            leave = jnp.maximum(leave, enter)
            return cls(enter, enter, leave, leave, 0, steps, 0)
        along = jnp.sum(rays.directions**2, -1)
        closest = -jnp.sum(rays.origins * rays.directions, -1) / along
        half = 1 - jnp.sum((rays.origins + closest[:, None] * rays.directions) ** 2, -1)
        half = jnp.sqrt(jnp.maximum(half, 0.0) / along)
        enter = jnp.clip(closest - half, near, far)
        leave = jnp.clip(closest + half, enter, far)
        full = jnp.full_like(enter, near)
        return cls(full, enter, leave, jnp.maximum(jnp.full_like(enter, far), leave), FRONT, steps, BEHIND)

    @property
    def count(self) -> int:
        """Steps per ray."""
        return self.front + self.inside + self.behind

    def at(self, u: Float[Array, "n k"]) -> Float[Array, "n k"]:
        """t at step coordinates u, a row for each ray."""
        near, enter, leave, far = (v[:, None] for v in (self.near, self.enter, self.leave, self.far))
        within = enter + (leave - enter) * ((u - self.front) / self.inside) if self.inside else enter
        if not self.behind:
            return within
        v = jnp.clip((u - self.front - self.inside) / self.behind, 0, 1)
        beyond = 1 / ((1 - v) / jnp.maximum(leave, 1e-6) + v / jnp.maximum(far, 1e-6))  # even in disparity
        if not self.front:
            return beyond
        before = near + (enter - near) * (u / self.front)
        return jnp.where(u < self.front, before, jnp.where(u < self.front + self.inside, within, beyond))


def box_interval(rays: Rays, half: Float[Array, "3"] | float = 1.0) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Where rays enter and leave the box [-half, half]; an empty interval where they miss it."""
    direction = jnp.where(jnp.abs(rays.directions) < 1e-9, 1e-9, rays.directions)
    first, second = (-half - rays.origins) / direction, (half - rays.origins) / direction
    return jnp.max(jnp.minimum(first, second), -1), jnp.min(jnp.maximum(first, second), -1)
