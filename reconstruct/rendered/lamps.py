"""Lamps that do not stand still with the object: seen from a moving frame, and near.

A ray's light is asked for in the lamps' own frame. Distant lamps need a direction there; near ones a place as well.
"""

from dataclasses import dataclass
from typing import Protocol

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from koala3d.reconstruct.numerics.safe import safe_norm


class Lamps(Protocol):
    """Light of a scene, in the lamps' own frame."""

    def convolved(
        self, directions: Float[Array, "3 n"], blur: float | Float[Array, " n"], places: Float[Array, "3 n"] | None = None
    ) -> Float[Array, "3 n"]:
        """Light around unit directions at some places, convolved with a lobe of concentration `blur`."""
        ...


@dataclass(frozen=True, eq=False)
class Ring:
    """Round soft lamps on a circle about the lens, in a dark room. The camera is at the origin and looks along z.

    A lamp is a lobe around the direction towards it. Nearer, it is larger and not brighter: its concentration grows with the
    square of the distance, its share of the light falls with it.
    """

    places: Float[np.ndarray, "lamps 3"]
    """Unit: that of the tracer."""
    concentration: float
    """At the distance 1."""
    colour: Float[np.ndarray, "lamps 3"]
    ambient: Float[np.ndarray, " 3"]

    @classmethod
    def about_lens(cls, *, lamps: int = 8, radius: float = 0.8, concentration: float = 6.0, brightness: float = 5.0) -> "Ring":
        """Lamps at equal distances, from warm to cold so that each is told from its neighbours."""
        angle = 2 * np.pi * np.arange(lamps) / lamps
        places = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(lamps)], -1)
        warm = np.cos(angle)[:, None] * [0.35, 0.0, -0.35] + np.sin(angle)[:, None] * [0.0, 0.2, 0.0]
        parts = (np.asarray(values, np.float32) for values in (places, brightness * (1 + warm), [0.06, 0.06, 0.07]))
        place, colour, ambient = parts
        return cls(place, concentration, colour, ambient)

    @classmethod
    def beside_lens(cls) -> "Ring":
        """One large lamp on an arm to the left of the camera and above it, as far from it as the object."""
        ring = cls.about_lens()
        place = np.array([[-4.0, -3.0, 0.0]], np.float32)
        return cls(place, 0.6, np.full((1, 3), 9.0, np.float32), ring.ambient)

    def convolved(
        self, directions: Float[Array, "3 n"], blur: float | Float[Array, " n"], places: Float[Array, "3 n"] | None = None
    ) -> Float[Array, "3 n"]:
        """Light around unit directions at some places, convolved with a lobe of concentration `blur`."""
        assert places is not None, "near lamps are lit from a place"
        total = jnp.broadcast_to(self.ambient[:, None], directions.shape)
        for place, colour in zip(self.places, self.colour, strict=True):
            towards = place[:, None] - places
            distance = safe_norm(towards, axis=0)
            own = self.concentration * distance**2
            both = own * blur / (own + blur)
            kept = (both / -jnp.expm1(-2 * both)) * (-jnp.expm1(-2 * own) / own)
            lobe = kept * jnp.exp(both * (jnp.sum(towards * directions, 0) / distance - 1))
            total = total + colour[:, None] * lobe
        return total


def arriving(
    lamps: Lamps,
    stand: Float[Array, "12 n"] | None,
    places: Float[Array, "3 n"],
    directions: Float[Array, "3 n"],
    blur: float | Float[Array, " n"],
) -> Float[Array, "3 n"]:
    """Light around unit directions at places of the scene.

    Args:
        stand: rows of the (3, 4) matrix that takes each place from the scene to the lamps; None: they stand still in the scene.
    """
    if stand is None:
        return lamps.convolved(directions, blur)
    rows = stand.reshape(3, 4, -1)
    turned = jnp.sum(rows[:, :3] * directions, 1)
    return lamps.convolved(turned, blur, jnp.sum(rows[:, :3] * places, 1) + rows[:, 3])
