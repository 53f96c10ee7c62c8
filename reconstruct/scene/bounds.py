"""How near and far a scene is seen, and how large its object is: numbers of one scene that compiled programs take as data.

So a program that was compiled for one scene serves the next.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from koala3d.reconstruct.scene.facts import SceneFacts


class Bounds(eqx.Module):
    """All in scene units."""

    near: Float[Array, ""]
    """Nearest depth."""
    far: Float[Array, ""]
    """Furthest depth."""
    half_box: Float[Array, " 3"] | None
    """Half the size of the object's box about the origin, in the unit ball; None: there is nothing around the object."""

    @classmethod
    def of(cls, facts: SceneFacts) -> "Bounds":
        """As they were measured."""
        near, far = (jnp.asarray(value, jnp.float32) for value in (facts.normalisation.near, facts.normalisation.far))
        return cls(near, far, None if facts.half_box is None else jnp.asarray(facts.half_box, jnp.float32))
