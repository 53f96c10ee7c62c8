"""A run's surface as splats, in the world frame of the scene: the robot's base for a capture."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.output.mesh import extraction
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.splats.colours import coefficients
from koala3d.reconstruct.splats.surfels import cover

OPACITY = 0.99
"""Of each splat at its middle."""


@dataclass(frozen=True)
class Splats:
    """Everything that files of n splats are written from; lengths in metres where `metric`, else in the scene's unit."""

    name: str
    points: Float[np.ndarray, "n 3"]
    quaternions: Float[np.ndarray, "n 4"]
    """Unit, w first: from the axes of a splat to those of the world."""
    scales: Float[np.ndarray, "n 3"]
    """Standard deviations along the axes of a splat; the third is its normal."""
    opacities: Float[np.ndarray, " n"]
    coefficients: Float[np.ndarray, "n 16 3"]
    """Of spherical harmonics, see `harmonics`; sRGB less 0.5."""
    metric: bool
    about: dict[str, Any]
    """What files keep of their origin."""


def make(trained: TrainedModel, *, count: int, stands_on: str | None = None) -> Splats:
    """At most `count` splats of a trained run's surface.

    Args:
        stands_on: see `extraction.extract`.

    Raises:
        UsageError: lamps move about the object: a splat's colour depends on the direction alone.
        ReconstructError: there is no surface in the box.
    """
    frame = trained.run.facts.light
    if frame.moves:
        why = f"they stand still in the frame '{frame.kind}', and a splat knows no light"
        raise UsageError("splats have one light: lamps move about the object", where=trained.run.path, why=why)
    surfels = cover(extraction.extract(trained, stands_on=stands_on), count)
    found, seen = coefficients(trained, surfels)
    about = {
        "run": str(trained.run.path),
        "scene": trained.scene.name,
        "steps": trained.step,
        "seen": float(seen.mean()),
        "surroundings": "left out" if not trained.run.normalisation.bounded else "none",
    }
    return Splats(
        trained.scene.name,
        surfels.points,
        surfels.quaternions,
        surfels.scales,
        np.full(len(surfels.points), OPACITY),
        found,
        trained.scene.metric,
        about,
    )
