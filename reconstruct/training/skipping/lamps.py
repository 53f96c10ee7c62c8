"""Where the lamps stand still: as a person says, else as the pictures say."""

import numpy as np
from numpy.typing import NDArray

from datasets.core.errors import UsageError
from datasets.scene import View
from reconstruct.config import Config
from reconstruct.scene.light import LightFrame
from reconstruct.scene.rays import Normalisation, Pixels
from reconstruct.scene.turntable import Turning, turning
from reconstruct.training.skipping.record import NOTHING_MORE, Skip

NAME = "moving_lamps"
SAVING = "a rotation of each reflected direction, and a network for the light on matte parts"

Decision = tuple[LightFrame, Skip]


def decided_light(
    views: tuple[View, ...], pixels: Pixels, normalisation: Normalisation, possible: NDArray[np.bool_] | None, config: Config
) -> Decision:
    """The frame in which the lamps of a scene stand still, and the evidence.

    Args:
        possible: cells of the object's cube that masks leave; None: there are no masks.

    Raises:
        UsageError: a turntable is asked for, but the cameras tell no axis.
    """
    if config.field.appearance != "reflection":
        return LightFrame(), Skip.of(NAME, True, "the model reflects nothing", NOTHING_MORE)
    wanted = config.light.frame
    if wanted in ("auto", "world"):
        return LightFrame(), Skip.of(NAME, True, "as configured: lamps stand still about the object", SAVING)
    found = frame(wanted, views, normalisation, config)
    return found, Skip.of(NAME, False, f"as configured: {wanted}", SAVING)


def frame(kind: str, views: tuple[View, ...], normalisation: Normalisation, config: Config) -> LightFrame:
    positions = np.stack([view.world_from_camera[:3, 3] for view in views]) - normalisation.centre
    distance = float(np.median(np.linalg.norm(positions, axis=-1))) * normalisation.scale
    axis = np.asarray(config.light.axis or (0.0, 0.0, 1.0))
    if kind == "turntable" and config.light.axis is None:
        found = turning(np.stack([view.world_from_camera[:3, :3] for view in views]))
        if found is None:
            raise UsageError(
                "no axis of a turntable is found",
                where="light.frame",
                why="no two views differ by a rotation",
                remedy="give light.axis",
            )
        axis = found.axis
    x, y, z = (axis / np.linalg.norm(axis)).tolist()
    return LightFrame(kind, (x, y, z), distance)
