"""Integrated positional encoding (Mip-NeRF, Barron et al. 2021, equations 9 to 14): sines and cosines, nothing learned.

    E[sin(f x)] = sin(f mean) exp(-f^2 variance / 2)   for x ~ N(mean, variance),

and the same for the cosine, for every frequency f and each axis by itself: only the diagonal of the covariance matters.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from koala3d.reconstruct.field.encodings.encoding import Scale
from koala3d.reconstruct.field.encodings.tables import resolutions_between
from koala3d.reconstruct.numerics.compiling import barrier


class Frequencies(eqx.Module):
    """Integrated positional encoding of the contracted scene."""

    blur: Float[Array, ""]
    """Standard deviation that every point has at least; see `Encoding`."""
    frequencies: tuple[float, ...] = eqx.field(static=True)
    """Angular frequencies [rad / scene unit]."""

    @classmethod
    def create(cls, *, levels: int, coarsest: float, finest: float) -> "Frequencies":
        """`levels` frequencies that grow geometrically from `coarsest` to `finest`; 1, 2, 4, ... 2^15 are Mip-NeRF's."""
        return cls(jnp.zeros(()), resolutions_between(coarsest, finest, levels))

    @property
    def num_channels(self) -> int:
        """A sine and a cosine per frequency and axis."""
        return 6 * len(self.frequencies)

    def __call__(self, points: Float[Array, "3 n"], scale: Scale | None = None) -> Float[Array, "channels n"]:
        """Expected sines of all frequencies and axes, then the cosines."""
        sine, cosine, _ = self._waves(points, scale)
        return jnp.concatenate([sine.reshape(-1, points.shape[1]), cosine.reshape(-1, points.shape[1])])

    def value_and_jacobian(
        self, points: Float[Array, "3 n"], scale: Scale | None = None
    ) -> tuple[Float[Array, "channels n"], Float[Array, "channels 3 n"]]:
        """Features and their derivative to the position, the scale held constant."""
        sine, cosine, frequency = self._waves(points, scale)
        along = jnp.eye(3, dtype=sine.dtype)[None, :, :, None]  # a channel depends on its own axis only
        slopes = [(frequency * cosine)[:, :, None] * along, (-frequency * sine)[:, :, None] * along]
        count = points.shape[1]
        values = jnp.concatenate([sine.reshape(-1, count), cosine.reshape(-1, count)])
        return values, jnp.concatenate([slope.reshape(-1, 3, count) for slope in slopes])

    @property
    def decay(self) -> float:
        """Zero: nothing is learned."""
        return 0.0

    def _waves(self, points, scale) -> tuple[Float[Array, "levels 3 n"], Float[Array, "levels 3 n"], Float[np.ndarray, "..."]]:
        """Attenuated sines and cosines, and the frequencies in a shape that multiplies them."""
        points = jax.lax.stop_gradient(points)
        frequency = np.array(self.frequencies, np.float32)[:, None, None]
        variance = jnp.square(self.blur) + (0.0 if scale is None else jnp.square(scale))
        attenuation = jnp.exp(-0.5 * jax.lax.stop_gradient(jnp.minimum(frequency**2 * variance, 200.0)))
        angle = barrier(frequency * points)
        sine, cosine = jnp.sin(angle) * attenuation, jnp.cos(angle) * attenuation
        return *barrier((sine, cosine)), frequency
