"""Whether poses are refined: not where they come from a calibrated arm, nor where matched points meet as well as they are found."""

from datasets.scene import Scene
from datasets.structure.matching import Matches
from datasets.structure.reprojection import Reprojection, reprojection_of
from reconstruct.config import Config
from reconstruct.models import merged_config
from reconstruct.scene.rays import Normalisation
from reconstruct.training.skipping.record import NOTHING_MORE, Skip


def with_poses(config: Config, matches: Matches | None, scene: Scene, normalisation: Normalisation) -> tuple[Config, Skip]:
    """The configuration with the decision on poses made, and the decision.

    Where poses are refined, their standard deviations are those that explain the distances of matched points.
    """
    wanted, found = config.poses.enabled, None
    if wanted == "auto":
        found = None if matches is None or "calibration" in scene.provenance else reprojection_of(matches)
        wanted = found is not None and found.doubtful
        changes: dict[str, object] = {"enabled": wanted}
        if found is not None and wanted:
            changes |= {"sigma_rad": found.beyond_rad, "sigma_m": found.beyond_rad * found.depth}
        config = merged_config(config, {"poses": changes})
    return config, Skip.of("poses", not wanted, _words(found, scene), NOTHING_MORE)


def _words(found: Reprojection | None, scene: Scene) -> str:
    if "calibration" in scene.provenance:
        return "poses come from a calibrated arm"
    return "not measured" if found is None else found.words()
