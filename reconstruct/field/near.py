"""What is near the points that are shaded, as far as reflections show it."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.scene.rays import Rays


class Near(eqx.Module):
    """Of n points."""

    places: Float[Array, "3 n"]
    """Where they are [scene unit]: data, no gradient goes to them."""
    light: Float[Array, "3 n"] | None = None
    """Linear light of what their reflected rays meet in the scene; None where no rays are cast."""
    opacity: Float[Array, " n"] | None = None
    """Share of a reflected ray that meets something in the scene, in [0, 1]."""

    @classmethod
    def on(cls, rays: Rays, t: Float[Array, " n"], ray: Int[Array, " n"] | None = None) -> "Near":
        """Points at distance t along rays, or along those with the given indices."""
        get = lambda a: a if ray is None else a.at[ray].get(mode="promise_in_bounds")  # noqa: E731
        return cls(jax.lax.stop_gradient((get(rays.origins) + get(rays.directions) * t[:, None]).T))

    def before(self, distant: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
        """Light along the reflected rays: that of the scene before the `distant` light."""
        if self.light is None or self.opacity is None:
            return distant
        return distant + self.opacity * (self.light - distant)


def mirrored(viewdirs: Float[Array, "3 n"], normals: Float[Array, "3 n"]) -> tuple[Float[Array, " n"], Float[Array, "3 n"]]:
    """Cosine between unit normals and the way to the camera, and the unit reflected directions (Ref-NeRF, equation 4)."""
    facing = -jnp.sum(normals * viewdirs, axis=0)
    return facing, 2 * facing * normals + viewdirs
