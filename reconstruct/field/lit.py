"""How points are to lamps that move about the object: directions and places in the frame in which the lamps stand still."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.numerics.safe import normalise
from koala3d.reconstruct.scene.light import LightFrame
from koala3d.reconstruct.scene.rays import Rays


class Lit(eqx.Module):
    """Of n points."""

    rotation: Float[Array, "n 3 3"]
    """From the scene's axes to the lamps'."""
    places: Float[Array, "3 n"]
    """Of the points from the camera, in the lamps' axes [scene unit]."""

    @classmethod
    def on(cls, rays: Rays, t: Float[Array, " n"], ray: Int[Array, " n"] | None = None) -> "Lit | None":
        """Of points at distance t along rays, or along those with the given indices; None where lamps stand still."""
        if rays.light is None:
            return None
        get = lambda a: a if ray is None else a.at[ray].get(mode="promise_in_bounds")  # noqa: E731
        rotation = get(rays.light)
        return cls(rotation, _rotated(rotation, (get(rays.directions) * t[:, None]).T))

    @classmethod
    def towards(cls, frame: LightFrame, viewdirs: Float[Array, "3 n"]) -> "Lit | None":
        """Of points that cameras look at along unit directions, upright and from their usual distance."""
        if not frame.moves:
            return None
        if frame.kind == "room":
            towards, turned = frame.of_room
            nearest = jnp.argmax(jnp.asarray(towards, jnp.float32) @ viewdirs, 0)
            rotation = jnp.asarray(turned, jnp.float32)[nearest]
            return cls(rotation, _rotated(rotation, frame.distance * viewdirs))
        sideways = np.cross(frame.axis, np.eye(3)[np.argmin(np.abs(frame.axis))])  # for those that look along the axis
        axis, sideways = jnp.asarray(frame.axis)[:, None], jnp.asarray(sideways, jnp.float32)[:, None]
        across = normalise(jnp.cross(axis, -viewdirs, axis=0) + 1e-6 * sideways, axis=0)
        rows = (across, jnp.cross(viewdirs, across, axis=0), viewdirs)
        if frame.kind == "turntable":
            rows = (jnp.cross(across, axis, axis=0), across, jnp.broadcast_to(axis, across.shape))
        rotation = jnp.stack(rows).transpose(2, 0, 1)
        return cls(rotation, _rotated(rotation, frame.distance * viewdirs))

    def turned(self, directions: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
        """Directions of the scene in the lamps' axes."""
        return _rotated(self.rotation, directions)

    def turned_about_lens(self, directions: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
        """The same after the shortest rotation that takes each point onto the optical axis.

        A lamp near the lens is then in nearly the same direction from all points: its parallax is taken out.
        """
        turned, ray = self.turned(directions), normalise(self.places, axis=0)
        axis = jnp.array([[0.0], [0.0], [1.0]])
        middle = ray + axis
        share = jnp.sum(middle * turned, 0) / jnp.maximum(1 + ray[2], 1e-6)  # points are before the camera
        return turned - middle * share + 2 * axis * jnp.sum(ray * turned, 0)

    def repeated(self, count: int) -> "Lit":
        """Each point `count` times."""
        return Lit(jnp.repeat(self.rotation, count, axis=0), jnp.repeat(self.places, count, axis=1))


def _rotated(rotation: Float[Array, "n 3 3"], vectors: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
    return jnp.sum(rotation.transpose(1, 2, 0) * vectors, 1)
