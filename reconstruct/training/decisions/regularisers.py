"""Whether a surface is regularised: not if neither masks nor the scene's box say what the object is."""

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.decisions.skip import Skip

NAME, WHAT = "regularisers", "regularisers of a surface, since nothing says what the object is"
SAVING = "the second pass, and the normals of first surfaces"


def decided(normalisation: Normalisation, scene: Scene, config: Config) -> Skip:
    """The decision; if it is to skip them, the overlay `unnamed` holds."""
    if normalisation.bounded or scene.box_is_stated:
        return Skip(NAME, WHAT, False, "masks or the scene's box say what the object is", SAVING)
    if not config.skip.regularisers:
        return Skip(NAME, WHAT, False, "forced", SAVING)
    skipped = bool(config.overlays.unnamed)
    return Skip(
        NAME, WHAT, skipped, "nothing says what the object is" + ("" if skipped else "; the model has no overlay for it"), SAVING
    )
