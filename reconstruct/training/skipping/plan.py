"""What a training leaves out: one rule per thing, each with its evidence and what it saves."""

from dataclasses import replace

import numpy as np

from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import Tree, merged, merged_config
from koala3d.reconstruct.sampling.create import sampler_type
from koala3d.reconstruct.sampling.steps import BEHIND, FRONT
from koala3d.reconstruct.scene.frustum import frustum_of
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.skipping.evidence import Evidence
from koala3d.reconstruct.training.skipping.record import ELSEWHERE, NOTHING_MORE, Skip

ALIKE = 1.5
"""Footprints whose largest is less than so many times the smallest count as uniform."""
MOSTLY = 0.4
"""Share of the object that keeps its colour, from which on it counts as matte: docs/skipping.md has it of all scenes."""

BOTTLENECK = 8
"""Fewest channels handed to the view network where nothing is known to reflect: each place may have its own light there."""
UNREGULARISED = {
    "surface": {"enabled": False, "normal_factor": 1},
    "losses": {
        "orientation": 0.0,
        "predicted_normals": 3e-4,
        "density_normals": 0.0,
        "last_density_normals": None,
        "hollowness": 0.0,
        "fog": 0.0,
    },
}
"""Shape from colour alone; predicted normals follow the density's, at Ref-NeRF's weight."""
MATTE = {
    "field": {"appearance": "view_diffuse"},
    "surface": {"bias": 0.0, "variation": 0.0, "normal_factor": 1},
    "losses": {"predicted_normals": 0.0, "density_normals": 0.0, "last_density_normals": None},
}
"""A diffuse colour, and a small part that changes with the view."""
MATTE_CONSISTENCY = 1.0
"""Largest weight of normal consistency there, and its second passes do not become more frequent: colours tell the shape."""
LAST_BLUR = 0.0005
"""Standard deviation of samples at the end there [scene unit]: normals of regularisers need more, colours lose detail by it."""

Decision = tuple[Config, Skip]


def normalisation_of(scene: Scene, config: Config) -> Normalisation:
    """How the scene is normalised: as one without surroundings only where that may be skipped."""
    found = Normalisation.of(scene)
    if found.bounded and not config.skip.surroundings:
        return Normalisation.of(replace(scene, background="scene"), backdrop=True)
    if found.bounded or scene.box_is_stated or not config.skip.contraction:
        return found
    views = scene.split("train")
    return replace(found, frustum=frustum_of(views, found.centre, found.scale, found.near, found.far))


def lenses(views: tuple[View, ...], config: Config) -> tuple[View, ...]:
    """The views as their pixels are to be undistorted: a pinhole that may not be skipped gets the least distortion there is."""
    if config.skip.distortion:
        return views
    bent = lambda camera: replace(camera, k1=np.finfo(float).tiny) if camera.is_pinhole else camera  # noqa: E731
    return tuple(replace(view, camera=bent(view.camera)) for view in views)


def plan(found: Evidence, config: Config) -> tuple[Config, list[Skip]]:
    """The configuration without what the scene does not need, and all decisions."""
    skips = [_surroundings(found, config), _contraction(found, config), _empty_rays(found, config)]
    for rule in (_regularisers, _reflection, _multisampling):
        config, skip = rule(found, config)
        skips.append(skip)
    skips += [_distortion(found, config), _structure_from_motion(found)]
    config, skip = _exposure(found, config)
    return config, [*skips, skip]


def _surroundings(found: Evidence, config: Config) -> Skip:
    skipped = found.bounded
    if skipped:
        evidence = f"pictures carry an alpha, {found.transparent:.0%} of their pixels show nothing"
    else:
        evidence = "pictures show surroundings" if config.skip.surroundings else "forced"
    steps = FRONT + BEHIND
    saving = f"{steps} of {steps + config.sampler.steps} steps along each ray, and the outer grid"
    return Skip.of("surroundings", skipped, evidence, saving)


def _contraction(found: Evidence, config: Config) -> Skip:
    skipped = found.frustum is not None
    if found.frustum is not None:
        evidence = f"all cameras look the same way: {np.rad2deg(np.arctan(found.frustum.across)):.0f} deg hold all that they see"
    elif found.bounded:
        evidence = "there are no surroundings"
    else:
        evidence = "cameras look different ways, or at a stated box" if config.skip.contraction else "forced"
    return Skip.of("contraction", skipped, evidence, "resolution where no camera looks; steps in front and behind")


def _empty_rays(found: Evidence, config: Config) -> Skip:
    if not sampler_type(config.sampler).rules_out_space:
        return Skip.of("empty_rays", False, "proposals have no grid", "nothing")
    by = "masks rule out" if found.bounded else "too few cameras see"
    evidence = f"{by} {1 - found.possible:.0%} of the space" if config.skip.empty_rays else "forced"
    return Skip.of("empty_rays", config.skip.empty_rays, evidence, "samples in there, and rays that meet nothing else")


def _regularisers(found: Evidence, config: Config) -> Decision:
    skipped = not found.object_known and config.skip.regularisers
    if skipped:
        config = _free(config, UNREGULARISED)
    evidence = "masks or the scene's box say what the object is" if found.object_known else "nothing says what the object is"
    return config, Skip.of("regularisers", skipped, evidence, "the second pass, and the normals of first surfaces")


def _multisampling(found: Evidence, config: Config) -> Decision:
    if sampler_type(config.sampler).frustum_of(config.sampler) != "hexagon":
        return config, Skip.of("multisampling", True, "this model takes one place per sample", NOTHING_MORE)
    ratio = found.largest / max(found.smallest, 1e-9)
    evidence = f"footprints differ by up to {ratio:.2g} times"
    skipped = ratio < ALIKE and config.skip.multisampling
    if skipped:
        config = merged_config(config, {"sampler": {"frustum": "gaussian"}})
    return config, Skip.of("multisampling", skipped, evidence, "5 of 6 evaluations of the encoding")


def _reflection(found: Evidence, config: Config) -> Decision:
    saving = "predicted normals, reflected directions and the regularisers that look at them"
    if config.field.appearance != "reflection":
        return config, Skip.of("reflection", True, "the model has none", NOTHING_MORE)
    if not config.skip.reflection:
        return config, Skip.of("reflection", False, "forced", saving)
    if found.matte is None:
        return config, Skip.of(
            "reflection", False, "without masks, or under lamps that move, nothing tells matte from shiny", saving
        )
    skipped = found.matte >= MOSTLY
    if skipped:
        surface = config.surface
        period = max(surface.first_period, surface.last_period)
        consistency = {"surface": {"normal": min(surface.normal, MATTE_CONSISTENCY), "last_period": period}}
        config = _free(config, merged(MATTE, consistency))
    return config, Skip.of("reflection", skipped, f"{found.matte:.0%} of the object keeps its colour from view to view", saving)


def _free(config: Config, changes: Tree) -> Config:
    """The configuration with these changes, a light of its own for each place, and less blur at the end."""
    bottleneck = max(config.field.bottleneck, BOTTLENECK)
    blur = min(config.train.last_blur, LAST_BLUR)
    return merged_config(config, merged(changes, {"field": {"bottleneck": bottleneck}, "train": {"last_blur": blur}}))


def _distortion(found: Evidence, config: Config) -> Skip:
    skipped = config.skip.distortion and not found.bent
    evidence = (
        f"{found.bent} of {found.views} views were taken through a lens that distorts" if config.skip.distortion else "forced"
    )
    return Skip.of("distortion", skipped, evidence, "Newton's method for each pixel, once")


def _structure_from_motion(found: Evidence) -> Skip:
    return Skip.of(
        "structure_from_motion", True, f"poses from {found.poses}; {ELSEWHERE['structure_from_motion']}", "matching the views"
    )


def _exposure(found: Evidence, config: Config) -> Decision:
    wanted, gains = config.train.per_image, found.gains
    if wanted == "auto":
        wanted = "none" if gains is None else gains.needed
        config = merged_config(config, {"train": {"per_image": wanted}})
    evidence = "not measured" if gains is None else gains.words()
    return config, Skip.of("exposure", wanted == "none", evidence, NOTHING_MORE)
