"""What every encoding of positions offers, so that fields do not know which one they have."""

from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Scale = Float[Array, " n"] | Float[Array, "3 n"]
"""Standard deviation of the Gaussian that each point stands for: one for all axes, or one per axis."""


@runtime_checkable
class Encoding(Protocol):
    """Positions in the encoding's space (the contracted scene) to features.

    Every implementation is an equinox module. Where a field is looked at is data: no gradient goes to points or scales.
    """

    blur: Float[Array, ""]
    """Standard deviation that every point has at least; training lowers it, so that shape comes before detail. No
    gradient goes to it."""

    @property
    def num_channels(self) -> int:
        """Number of features."""
        ...

    def __call__(self, points: Float[Array, "3 n"], scale: Scale | None = None) -> Float[Array, "channels n"]:
        """Features; the finer they are, the less they weigh for a wide Gaussian. None: points have no extent."""
        ...

    def value_and_jacobian(
        self, points: Float[Array, "3 n"], scale: Scale | None = None
    ) -> tuple[Float[Array, "channels n"], Float[Array, "channels 3 n"]]:
        """Features and their derivative to the position, the scale held constant."""
        ...

    @property
    def decay(self) -> float:
        """Slope of weight decay at each learned feature, per value: of the mean square of features, summed over levels."""
        ...


def blurred(blur: Float[Array, ""], scale: Scale | None) -> Float[Array, " _"]:
    """One standard deviation per point, without gradient: its own (root mean square over the axes) and the blur together."""
    squared = jnp.square(blur)[None]
    if scale is not None:
        own = jnp.square(scale)
        squared = squared + (own if scale.ndim == 1 else jnp.mean(own, 0))
    return jax.lax.stop_gradient(jnp.sqrt(squared + 1e-24))
