"""What a closed surface encloses: volume and centre of mass, and how well they are known.

A surface is where a ray has lost half of its light. How far it may lie from there is taken from the model: half of what lies
between the surfaces where 16 % and 84 % are lost, one standard deviation to either side of a step that is smeared as by a normal
distribution. The whole surface is taken to err alike, so nothing averages out. Where the object was turned over, one half may lie
off the other by the stated deviation of that motion; it counts with the mean cross-section, a quarter of the surface (Cauchy).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from koala3d.datasets.scene import TURNED, Scene
from koala3d.reconstruct.output.mesh.closing import is_closed

if TYPE_CHECKING:
    import trimesh

AROUND = (0.16, 0.84)
"""Shares of the light that is lost, between which the surface is: one standard deviation to either side."""
SHELLS = "_shells"
"""Entry of a surface's metadata: volume and centre of each of these two surfaces, where they are closed. Trimesh writes no entry
with such a name into files."""


@dataclass(frozen=True)
class Solid:
    """Of one material, inside a closed surface."""

    volume: float
    """[world unit^3]."""
    centre: tuple[float, float, float]
    """Of mass [world unit]."""
    volume_deviation: float | None
    """Standard deviation; None: one of the surfaces around it is open."""
    centre_deviation: tuple[float, float, float] | None
    """The same, along each axis."""

    @classmethod
    def of(cls, surface: "trimesh.Trimesh", scene: Scene) -> "Solid | None":
        """What a surface of `extraction.extract` encloses; None where it is open."""
        if not is_closed(surface):
            return None
        volume, centre = float(surface.volume), surface.center_mass
        shells = surface.metadata.get(SHELLS)
        if shells is None:
            return cls(volume, _vector(centre), None, None)
        (inner, from_inner), (outer, from_outer) = shells
        shift = _shift(scene)
        between, across = abs(outer - inner) / 2, float(surface.area) / 4
        aside = np.abs(from_outer - from_inner) / 2
        return cls(volume, _vector(centre), float(np.hypot(between, across * shift)), _vector(np.hypot(aside, shift / 2)))

    def to_json(self) -> dict[str, Any]:
        """Entries of a summary."""
        return {
            "volume": self.volume,
            "volume_deviation": self.volume_deviation,
            "centre_of_mass": self.centre,
            "centre_of_mass_deviation": self.centre_deviation,
        }

    def words(self, scene: Scene) -> str:
        """For a person."""
        cubic, unit, small = (1e6, "cm3", "mm") if scene.metric else (1.0, "cubic units", "thousandths of a unit")
        volume, at = f"{cubic * self.volume:.5g}", ", ".join(f"{value:.4f}" for value in self.centre)
        if self.volume_deviation is None or self.centre_deviation is None:
            return f"volume {volume} {unit}, centre of mass at {at}"
        off = float(1e3 * np.linalg.norm(self.centre_deviation))
        volume += f" ± {cubic * self.volume_deviation:.2g}"
        return f"volume {volume} {unit}, centre of mass at {at} ± {off:.2g} {small}"


def _shift(scene: Scene) -> float:
    """Standard deviation, in the worst direction, of where one half of an object that was turned over is to the other."""
    if (stated := scene.provenance.get(TURNED)) is None:
        return 0.0
    return float(np.sqrt(np.linalg.eigvalsh(np.asarray(stated["covariance"])[:3, :3])[-1]))


def _vector(values: Float[np.ndarray, " 3"]) -> tuple[float, float, float]:
    x, y, z = np.asarray(values, np.float64).tolist()
    return x, y, z
