"""Distant light as a sum of lobes, so that reflection by rough mirrors and matte surfaces has a closed form.

A lobe sends amplitude * exp(concentration * (cosine - 1)) around its axis (von Mises-Fisher). Convolution of a lobe of
concentration k with one of concentration c gives about the concentration k c / (k + c) and preserves the energy.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

MATTE = 2.133
"""Concentration of the lobe that approximates the cosine of a matte surface (Wang et al. 2009)."""
BRIGHTEST = 5.0  # linear light of the brightest lamp


@dataclass(frozen=True, eq=False)
class Light:
    """Lobes around a scene; linear light."""

    axes: Float[np.ndarray, "lobes 3"]
    concentration: Float[np.ndarray, " lobes"]
    colour: Float[np.ndarray, "lobes 3"]
    ambient: Float[np.ndarray, " 3"]

    @classmethod
    def studio(cls, seed: int, *, lamps: int = 5, cards: int = 26) -> "Light":
        """A studio: sky and floor, a few soft lamps above, and many coloured cards all around."""
        rng = np.random.default_rng(seed)
        axes, concentration, colour = [[0.0, 0, 1], [0, 0, -1]], [1.5, 2.0], [[0.30, 0.33, 0.38], [0.16, 0.12, 0.09]]
        for index in range(lamps):
            angle, height = 2 * np.pi * (index + 0.6 * rng.random()) / lamps, rng.uniform(0.25, 0.85)
            axes.append(_direction(angle, height))
            concentration.append(rng.uniform(60, 300))
            brightness = rng.uniform(0.4 * BRIGHTEST, BRIGHTEST)
            colour.append((brightness * np.array([1.0, rng.uniform(0.88, 1.0), rng.uniform(0.75, 1.0)])).tolist())
        for index in range(cards):  # an even spiral of directions
            height = 0.95 * (1 - 2 * (index + 0.5) / cards)
            axes.append(_direction(index * 2.39996 + 0.5 * rng.random(), height))
            concentration.append(rng.uniform(15, 200))
            colour.append((rng.uniform(0.2, 0.8) * 2 * rng.dirichlet([1.2] * 3)).tolist())
        parts = (np.asarray(values, np.float32) for values in (axes, concentration, colour, [0.06, 0.06, 0.07]))
        return cls(*parts)

    def convolved(
        self, directions: Float[Array, "3 n"], blur: float | Float[Array, " n"], places: Float[Array, "3 n"] | None = None
    ) -> Float[Array, "3 n"]:
        """Light around unit directions, convolved with a lobe of concentration `blur`: the same at all places."""
        own = self.concentration[:, None]
        both = own * blur / (own + blur)
        kept = (both / -jnp.expm1(-2 * both)) * (-np.expm1(-2 * own) / own)  # a wider lobe is a weaker one
        cosine = jnp.matmul(self.axes, directions, precision="highest")
        lobes = kept * jnp.exp(both * (cosine - 1))
        return jnp.matmul(self.colour.T, lobes, precision="highest") + self.ambient[:, None]


def _direction(angle: float, height: float) -> list[float]:
    across = float(np.sqrt(1 - height**2))
    return [across * float(np.cos(angle)), across * float(np.sin(angle)), height]
