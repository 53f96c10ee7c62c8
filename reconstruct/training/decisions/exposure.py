"""Whether a gain of each picture is learned: if matched points differ in brightness or colour between pictures."""

from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import merged_config
from koala3d.reconstruct.training.decisions.evidence.gains import Differences
from koala3d.reconstruct.training.decisions.skip import Skip

NAME, WHAT = "exposure", "a gain of each picture's light"
FORCED = "train.per_image=colour"


def decided(gains: Differences | None, config: Config) -> tuple[Config, Skip]:
    """The configuration with the decision made, and the decision. `gains`: None: not measured."""
    wanted = config.train.per_image
    if wanted == "auto":
        wanted = "none" if gains is None else gains.needed
        config = merged_config(config, {"train": {"per_image": wanted}})
    return config, Skip(NAME, WHAT, wanted == "none", "not measured" if gains is None else gains.words())
