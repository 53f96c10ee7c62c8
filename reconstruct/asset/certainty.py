"""How well each point of the surface was seen: by how many views, how squarely, and from how different directions."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

MEANING = (
    "red: training views that see the texel, counted in steps of 1/255; green: largest cosine between its normal and the "
    "direction to one of them; blue: spread of these directions, 0 to 90 degrees; black: seen by none, "
    "values copied from the nearest seen"
)
"""Of the texture."""
ENOUGH = 3  # views, from which on a point counts as seen in summaries


@dataclass(frozen=True)
class Certainty:
    """Of n points."""

    views: Int[np.ndarray, " n"]
    """Number of training views that see the point."""
    squarely: Float[np.ndarray, " n"]
    """Largest cosine between the normal and the direction to a view that sees it; 0 where none does."""
    spread_deg: Float[np.ndarray, " n"]
    """Root mean square angle of these directions from their mean [deg]: what depends on the direction (reflectance, roughness)
    is known only where it is large."""

    def channels(self) -> Float[np.ndarray, "n 3"]:
        """0..1 as a picture has them: views / 255, cosine, spread / 90 degrees."""
        return np.stack([np.minimum(self.views, 255) / 255, self.squarely, np.minimum(self.spread_deg / 90, 1)], -1)

    def summary(self) -> dict[str, float]:
        """For a file of results."""
        return {
            "seen_by_3_views": float(np.mean(self.views >= ENOUGH)),
            "unseen": float(np.mean(self.views == 0)),
            "median_views": float(np.median(self.views)),
            "median_spread_deg": float(np.median(self.spread_deg)),
        }


class Sightings:
    """Sums over views."""

    def __init__(self, count: int) -> None:
        self._views, self._squarely, self._sum = np.zeros(count, np.int64), np.zeros(count), np.zeros((count, 3))

    def add(self, seen: Bool[np.ndarray, " n"], cosines: Float[np.ndarray, " n"], rays: Float[np.ndarray, "n 3"]) -> None:
        """Add a view: which points it sees, under which cosine to their normals, along which unit rays."""
        self._views += seen
        self._squarely = np.where(seen, np.maximum(self._squarely, cosines), self._squarely)
        self._sum[seen] += rays[seen]

    def certainty(self) -> Certainty:
        """Of all views so far.

        For angles a from the mean direction, the length of the mean of unit vectors is the mean of cos(a), about 1 - a^2 / 2.
        """
        length = np.linalg.norm(self._sum, axis=-1) / np.maximum(self._views, 1)
        spread = np.sqrt(np.maximum(2 * (1 - length), 0))
        return Certainty(self._views, np.clip(self._squarely, 0, 1), np.where(self._views > 0, np.rad2deg(spread), 0.0))
