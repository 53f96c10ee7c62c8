"""Whether poses are refined: where they do not come from a calibrated arm, and matched points miss one another.

Reflections that move over an object look the same as cameras that are not where they are given; so nothing is refined where the
pictures show an object alone. How an object was turned over is corrected where it is known less well than pictures could tell.
"""

from typing import Literal

import numpy as np

from koala3d.datasets.scene import TURNED, Scene
from koala3d.datasets.structure.matching import Matches
from koala3d.datasets.structure.placement import Reprojection, reprojection_of
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import merged_config
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.decisions.skip import Skip

NAME, WHAT = "poses", "a correction of each picture's pose"
FORCED = "poses.enabled=true"
CALIBRATED = "calibration"
"""What scenes that were built from a recording have in their provenance."""
FREE_PX = 0.5
"""Deviation of the motion of an object that was turned over, in pixels at its surface, from which training corrects it."""


def corrects_motion(wanted: bool | Literal["auto"], scene: Scene) -> bool:
    """Whether the motion of an object that was turned over is free while the scene is trained, if `poses.enabled` is `wanted`."""
    if TURNED not in scene.provenance or wanted is False:
        return False
    return wanted is True or motion_px(scene) >= FREE_PX


def motion_px(scene: Scene) -> float:
    """Stated deviation of the motion of an object that was turned over, at half its size from its middle, in pixels there."""
    stated = scene.provenance[TURNED]
    variance = np.diag(np.asarray(stated["covariance"], np.float64))
    radius = float(np.ptp(scene.box, axis=0).mean()) / 2
    places = np.stack([view.world_from_camera[:3, 3] for view in scene.views])
    away = np.linalg.norm(places - np.asarray(stated["middle"]), axis=-1)
    pixel = float(np.median(away / [(view.camera.fx + view.camera.fy) / 2 for view in scene.views]))
    return float(np.sqrt(variance[:3].sum() + variance[3:].sum() * radius**2)) / pixel


def decided(config: Config, matches: Matches | None, scene: Scene, normalisation: Normalisation) -> tuple[Config, Skip]:
    """The configuration with the decision on poses made, and the decision.

    Where poses are refined, their standard deviations are those that explain the distances of matched points.
    """
    wanted, found, motion = config.poses.enabled, None, ""
    if TURNED in scene.provenance:
        done = "corrected" if corrects_motion(wanted, scene) else "kept"
        motion = f"; how the object was turned over is known to {motion_px(scene):.2g} px and {done}"
    if wanted == "auto":
        found = None if matches is None or normalisation.bounded or CALIBRATED in scene.provenance else reprojection_of(matches)
        wanted = found is not None and found.doubtful
        changes: dict[str, object] = {"enabled": wanted}
        if found is not None and wanted:
            changes |= {"sigma_rad": found.beyond_rad, "sigma_m": found.beyond_rad * found.depth}
        config = merged_config(config, {"poses": changes})
    return config, Skip(NAME, WHAT, not wanted, _words(found, scene, normalisation) + motion)


def _words(found: Reprojection | None, scene: Scene, normalisation: Normalisation) -> str:
    if found is not None:
        return found.words()
    if CALIBRATED in scene.provenance:
        return "poses come from a calibrated arm"
    return "pictures show an object alone, whose reflections may move" if normalisation.bounded else "not measured"
