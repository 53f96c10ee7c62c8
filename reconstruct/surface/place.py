"""Where surface points lie in the field."""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from koala3d.reconstruct.field.cloud import Cloud, points_on_rays
from koala3d.reconstruct.sampling.focus import INSET
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import Space
from koala3d.reconstruct.surface.first_surface import HALF_WIDTH, Surface


@dataclass(frozen=True)
class Place:
    """How surface points become places in the field: in their space, as points or as Gaussians."""

    space: Space
    extended: bool = False
    """Whether each stands for an isotropic Gaussian as wide as its pixel's cone, which looks the same from all sides."""

    def in_box(self, rays: Rays, surface: Surface, half_box: Float[Array, " 3"] | None) -> Bool[Array, " n"]:
        """Whether each surface point is in the object's box, less a margin into which what it stands on may reach.

        Args:
            half_box: as of `Bounds`.
        """
        if half_box is None:
            return jnp.ones(surface.t.shape, bool)
        half = half_box[:, None] * (1 - INSET)
        return jnp.all(jnp.abs(self.of(rays, surface).points) < half, 0)

    def of(self, rays: Rays, surface: Surface, offsets: Float[Array, "n around 3"] | None = None) -> Cloud:
        """The surface points, or `offsets` [scene unit] around each of them, point after point."""
        points = points_on_rays(rays, surface.ray, surface.t, self.space).points
        scale = surface.radius / HALF_WIDTH if self.extended else None
        if offsets is not None:
            points = (points.T[:, None] + offsets).reshape(-1, 3).T
            scale = None if scale is None else jnp.repeat(scale, offsets.shape[1])
        return Cloud(points, scale, self.space)
