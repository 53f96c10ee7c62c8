from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure.exposure import ExposureGains
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.scene.rays import Normalisation, view_rays
from koala3d.reconstruct.training.skipping.evidence import Evidence
from koala3d.reconstruct.training.skipping.gains import Differences
from koala3d.reconstruct.training.skipping.plan import lenses, normalisation_of, plan
from koala3d.reconstruct.training.skipping.record import NAMES, Skip

FOUND = Evidence(
    bounded=True, views=8, transparent=0.7, smallest=0.01, largest=0.012, possible=0.1, bent=0, frustum=None, poses="koala-scene"
)


def planned(found: Evidence = FOUND, **skip: bool) -> tuple[Config, dict[str, Skip]]:
    """A plan for the fast preset with these skips on or off, and its decisions by name."""
    base = load_config(overrides=[*(f"skip.{name}={str(value).lower()}" for name, value in skip.items())])
    config, skips = plan(found, base)
    assert [skip.name for skip in skips] == list(dict.fromkeys(skip.name for skip in skips)), "one decision each"
    return config, {skip.name: skip for skip in skips}


def test_every_skip_is_decided_with_evidence_saving_and_cost() -> None:
    _, skips = planned()
    assert set(skips) == {*NAMES, "exposure", "structure_from_motion"}
    for skip in skips.values():
        assert skip.evidence and skip.saving and skip.cost


def test_a_disabled_skip_changes_nothing() -> None:
    names = dict.fromkeys(NAMES, False)
    base = load_config(overrides=["train.per_image=none", *(f"skip.{name}=false" for name in names)])
    config, skips = plan(FOUND, base)
    assert config == base
    assert not any(skip.skipped for skip in skips if skip.name in names and skip.name not in ("surroundings", "multisampling"))


def test_multisampling_goes_where_footprints_are_alike() -> None:
    base = load_config(preset="paper", overrides=["skip.multisampling=true"])
    assert plan(FOUND, base)[0].sampler.frustum == "gaussian"
    assert plan(replace(FOUND, largest=0.02), base)[0].sampler.frustum == "hexagon"
    assert planned(multisampling=True)[0].sampler == load_config().sampler, "the fast preset has none"


@pytest.mark.parametrize(("matte", "left_out"), [(None, False), (0.2, False), (0.5, True)])
def test_reflections_go_where_most_of_the_object_keeps_its_colour(matte: float | None, left_out: bool) -> None:
    found = replace(FOUND, matte=matte)
    config, skips = planned(found)
    assert (config.field.appearance == "view_diffuse") == left_out and skips["reflection"].skipped == left_out
    assert (config.surface.bias == config.losses.density_normals == 0) == left_out
    assert (config.losses.last_density_normals is None) == left_out
    assert config.surface.normal_factor == (1 if left_out else load_config().surface.normal_factor)
    assert config.surface.normal == (1 if left_out else load_config().surface.normal), "the shape is regularised still"
    assert config.surface.last_period == (config.surface.first_period if left_out else load_config().surface.last_period)
    assert config.losses.hollowness > 0
    assert (config.field.bottleneck >= 8) == left_out, "a light for each place"
    assert planned(found, reflection=False)[0].field.appearance == "reflection"


def test_a_bounded_scene_may_be_kept_from_losing_its_surroundings(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(mask=True)
    assert normalisation_of(scene, load_config()) == Normalisation.of(scene) and Normalisation.of(scene).bounded
    kept = normalisation_of(scene, load_config(overrides=["skip.surroundings=false"]))
    assert not kept.bounded and kept.backdrop
    assert not normalisation_of(make_scene(), load_config()).backdrop


def test_the_long_way_to_undistort_a_pinhole_gives_the_same_rays(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene()
    (first, *_), (forced, *_) = scene.views, lenses(scene.views, load_config(overrides=["skip.distortion=false"]))
    assert lenses(scene.views, load_config()) is scene.views
    assert not forced.camera.is_pinhole, "Newton's method is taken"
    for one, other in zip(*(view_rays(view, Normalisation.of(scene)) for view in (first, forced)), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)
    bent = replace(first, camera=replace(Camera(96, 72, 90.0, 90.0, 48.0, 36.0), k1=-0.1))
    assert lenses((bent,), load_config(overrides=["skip.distortion=false"]))[0] is not None


def gains_of(log: list[list[float]]) -> Differences:
    """Gains that are sure."""
    names = tuple(f"{index:02d}" for index in range(len(log)))
    return Differences(ExposureGains(names, np.array(log), np.full((len(log), 3), 0.01), np.full(len(log), 500)))


@pytest.mark.parametrize(("log", "chosen"), [
    ([[0.0] * 3, [0.2] * 3], "none"),
    ([[0.0] * 3, [0.6] * 3], "exposure"),
    ([[0.0] * 3, [0.6, 0.5, 0.2]], "colour"),
    (None, "none"),
])  # fmt: skip
def test_gains_are_learned_where_views_differ(log: list[list[float]] | None, chosen: str) -> None:
    found = replace(FOUND, gains=None if log is None else gains_of(log))
    config, skips = planned(found)
    assert config.train.per_image == chosen and skips["exposure"].skipped == (chosen == "none")


def test_what_a_person_sets_is_learned_whatever_was_found() -> None:
    found = replace(FOUND, gains=gains_of([[0.0] * 3, [0.6] * 3]))
    for chosen in ("none", "exposure", "colour"):
        config, skips = plan(found, load_config(overrides=[f"train.per_image={chosen}"]))
        assert config.train.per_image == chosen
        assert {skip.name: skip.skipped for skip in skips}["exposure"] == (chosen == "none")


@pytest.mark.parametrize(("known", "given", "left"), [(True, 0.002, 0.002), (False, 0.002, 0.0005), (False, 1e-4, 1e-4)])
def test_blur_at_the_end_goes_with_the_regularisers(known: bool, given: float, left: float) -> None:
    """A person who asks for less keeps it."""
    base = load_config(overrides=[f"train.last_blur={given}"])
    config, _ = plan(replace(FOUND, object_known=known), base)
    assert config.train.last_blur == left and config.surface.enabled == known
