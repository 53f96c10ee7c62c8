"""Whether a scene has surroundings: none if its pictures carry an alpha."""

from dataclasses import replace

import numpy as np

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.sampling.steps import BEHIND, FRONT
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.training.decisions.skip import Skip

NAME, WHAT = "surroundings", "what is around the object"


def normalised(scene: Scene, config: Config) -> Normalisation:
    """The scene's normalisation, with a backdrop in place of an alpha that must not count."""
    found = Normalisation.of(scene)
    if found.bounded and not config.skip.surroundings:
        return Normalisation.of(replace(scene, background="scene"), backdrop=True)
    return found


def decided(normalisation: Normalisation, pixels: Pixels, config: Config) -> Skip:
    """The decision that `normalised` made."""
    steps = FRONT + BEHIND
    saving = f"{steps} of {steps + config.sampler.steps} steps along each ray, and the outer grid"
    if normalisation.bounded:
        nothing = float(np.mean(np.asarray(pixels.colour[:, 3]) < 0.01))
        return Skip(NAME, WHAT, True, f"pictures carry an alpha, {nothing:.0%} of their pixels show nothing", saving)
    return Skip(NAME, WHAT, False, "pictures show surroundings" if config.skip.surroundings else "forced", saving)
