"""What lamps that move about an object change of its colours.

Reflected directions are encoded in the frame in which the lamps stand still. A matte point has no colour of its own any more: its
diffuse colour is multiplied by an irradiance, which is smooth in the normal (Ramamoorthi and Hanrahan 2001: nearly a quadratic
polynomial). Near lamps look different from each place, on which both then depend.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.field.mlp import Mlp
from koala3d.reconstruct.scene.light import LightFrame

WIDTH = 32
"""Of the network from a normal to the light that a matte surface receives."""
POLYNOMIAL, PLACE = 9, 3
"""Channels of a normal, and of a place."""

Columns = Float[Array, "3 n"]


class MovingLamps(eqx.Module):
    """Of one scene."""

    network: Mlp
    """From a normal to the raw irradiance."""
    near: bool = eqx.field(static=True)
    distance: float = eqx.field(static=True)
    """Usual distance of the cameras [scene unit]."""

    @classmethod
    def create(cls, key: PRNGKeyArray, light: LightFrame) -> "MovingLamps":
        """Fresh weights."""
        channels = POLYNOMIAL + (PLACE if light.near else 0)
        return cls(Mlp.create(key, channels=channels, width=WIDTH, depth=1, outputs=3), light.near, light.distance)

    @property
    def channels(self) -> int:
        """Of the place, for networks that take it beside a direction."""
        return PLACE if self.near else 0

    def seen_by(self, light: Lit, directions: Columns) -> tuple[Columns, list[Columns]]:
        """Unit directions of the scene, and the places where they matter, as networks take them."""
        if not self.near:
            return light.turned(directions), []
        ahead = jnp.array([[0.0], [0.0], [1.0]])
        return light.turned_about_lens(directions), [light.places / self.distance - ahead]

    def irradiance(self, light: Lit, normals: Columns) -> Columns:
        """Factor on the diffuse colour of points with these unit normals: about one at first."""
        (x, y, z), places = self.seen_by(light, normals)
        polynomial = jnp.stack([x, y, z, x * y, y * z, z * x, x * x, y * y, z * z])
        return jax.nn.softplus(self.network(jnp.concatenate([polynomial, *places]))) / np.log(2)
