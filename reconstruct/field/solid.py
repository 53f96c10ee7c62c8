"""Where matter is solid: light is lost there where the density rises, and elsewhere along the way; see `volume.optical_depth`."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

Solidity = float | Float[Array, " n"]
"""Share of the one rule in the other at places, in [0, 1]; a number if it is the same everywhere and always."""


class Solid(eqx.Module):
    """All that there is, or an object among surroundings. Nothing here is learned."""

    half_box: tuple[float, float, float] | None = eqx.field(static=True)
    """Half the size of the object's box about the origin [scene unit]; None: everything is solid, from the first step on."""
    share: Float[Array, ""] | None
    """How solid the object is; see `Schedule.solidity`. Before there is a shape, a fog has to find one."""

    @classmethod
    def throughout(cls) -> "Solid":
        """Everything is solid."""
        return cls(None, None)

    @classmethod
    def within(cls, half_box: tuple[float, float, float]) -> "Solid":
        """An object in its box, a fog as yet."""
        return cls(half_box, jnp.zeros(()))

    def at(self, points: Float[Array, "3 n"]) -> Solidity:
        """How solid matter is at points around the object."""
        if self.half_box is None:
            return 1.0
        inside = jnp.all(jnp.abs(points) < jnp.asarray(self.half_box, points.dtype)[:, None], 0)
        return jnp.where(inside, self.share, 0.0)
