"""Whether poses are refined: where they do not come from a calibrated arm, and matched points miss one another.

Reflections that move over an object look the same as cameras that are not where they are given; so nothing is refined where the
pictures show an object alone.
"""

from koala3d.datasets.scene import Scene
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


def decided(config: Config, matches: Matches | None, scene: Scene, normalisation: Normalisation) -> tuple[Config, Skip]:
    """The configuration with the decision on poses made, and the decision.

    Where poses are refined, their standard deviations are those that explain the distances of matched points.
    """
    wanted, found = config.poses.enabled, None
    if wanted == "auto":
        found = None if matches is None or normalisation.bounded or CALIBRATED in scene.provenance else reprojection_of(matches)
        wanted = found is not None and found.doubtful
        changes: dict[str, object] = {"enabled": wanted}
        if found is not None and wanted:
            changes |= {"sigma_rad": found.beyond_rad, "sigma_m": found.beyond_rad * found.depth}
        config = merged_config(config, {"poses": changes})
    return config, Skip(NAME, WHAT, not wanted, _words(found, scene, normalisation))


def _words(found: Reprojection | None, scene: Scene, normalisation: Normalisation) -> str:
    if found is not None:
        return found.words()
    if CALIBRATED in scene.provenance:
        return "poses come from a calibrated arm"
    return "pictures show an object alone, whose reflections may move" if normalisation.bounded else "not measured"
