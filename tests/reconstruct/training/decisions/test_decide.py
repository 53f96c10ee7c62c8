"""Decisions by their rules, and the configuration that follows from them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets.scene import Scene
from koala3d.datasets.structure.exposure import ExposureGains
from koala3d.reconstruct.config import SkipConfig
from koala3d.reconstruct.models import load_config, of_kinds
from koala3d.reconstruct.sampling.hull import cells_in_masks
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.decisions import exposure, reflection, regularisers
from koala3d.reconstruct.training.decisions.decide import Decided, decided, normalisation_of
from koala3d.reconstruct.training.decisions.evidence.gains import Differences
from tests.small import pixels_of


def decisions(scene: Scene, *overrides: str, masks: bool = False) -> Decided:
    config = load_config(overrides=["sampler.grid=32", *overrides])
    normalisation = normalisation_of(scene, config)
    pixels = pixels_of(scene, normalisation)
    cells = cells_in_masks(pixels, scene.split("train"), normalisation, 32, 1.0) if masks else None
    return decided(scene, pixels, normalisation, cells, None, config)


def test_a_masked_scene_is_blank_and_mostly_empty(make_scene: Callable[..., Scene]) -> None:
    config, facts, skips = decisions(make_scene(mask=True), masks=True)
    found = {skip.name: skip for skip in skips}
    assert set(found) == {*SkipConfig.model_fields, "dark_start", "exposure", "moving_lamps"}
    assert facts.normalisation.bounded and config.kinds == ("blank",)
    nothing = 1 - np.pi * 20**2 / (96 * 72)  # the mask is a disc of 20 pixels
    assert found["surroundings"].skipped and f"{nothing:.0%}" in found["surroundings"].evidence
    assert found["empty_rays"].evidence.startswith("masks rule out") and not found["regularisers"].skipped
    assert all(skip.evidence and skip.what for skip in skips)


def test_surroundings_of_an_object_that_nobody_names(make_scene: Callable[..., Scene]) -> None:
    scene = replace(make_scene(), bounds_from="cameras alone")
    config, _, skips = decisions(scene)
    assert config.kinds == ("surroundings", "unnamed") and not config.surface.enabled
    assert [skip.skipped for skip in skips if skip.name == "regularisers"] == [True]
    kept, _, _ = decisions(scene, "skip.regularisers=false")
    assert kept.kinds == ("surroundings",) and kept.surface.enabled
    assert decisions(replace(scene, bounds_from="stated")).config.kinds == ("surroundings",)


def test_what_is_solid(make_scene: Callable[..., Scene]) -> None:
    masked = make_scene(mask=True)
    assert decisions(masked, masks=True).config.field.matter == "solid"
    assert decisions(masked).config.field.matter == "fog", "no hull"
    assert decisions(make_scene()).config.field.matter == "fog"


def test_a_decided_configuration_has_plain_values_alone(make_scene: Callable[..., Scene]) -> None:
    config = decisions(make_scene(mask=True)).config
    assert not any(config.overlays.model_dump().values()) and config.train.per_image == "none"
    assert (config.schedule.share_from, config.light.parallax, config.sampler.optical_depth) == (0, "learned", 0.005)


def test_a_masked_scene_may_be_kept_from_losing_its_surroundings(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(mask=True)
    assert normalisation_of(scene, load_config()) == Normalisation.of(scene) and Normalisation.of(scene).bounded
    kept = normalisation_of(scene, load_config(overrides=["skip.surroundings=false"]))
    assert not kept.bounded and kept.backdrop
    assert not normalisation_of(make_scene(), load_config()).backdrop


@pytest.mark.parametrize(("matte", "left_out"), [(None, False), (0.2, False), (0.5, True)])
def test_reflections_go_where_most_of_the_object_keeps_its_colour(matte: float | None, left_out: bool) -> None:
    assert reflection.decided(matte, load_config()).skipped == left_out
    for overrides in (["skip.reflection=false"], ["field.appearance=view"]):
        assert not reflection.decided(matte, load_config(overrides=overrides)).skipped
    assert not reflection.decided(matte, load_config("refnerf")).skipped, "it has no overlay for matte objects"


def test_a_matte_object_has_a_light_for_each_place_and_a_regularised_shape() -> None:
    config = of_kinds(load_config(), ["blank", "matte"])
    assert config.field.appearance == "view_diffuse" and config.field.bottleneck == 8
    assert config.surface.bias == config.losses.density_normals == 0 and config.losses.last_density_normals is None
    assert config.surface.normal == 1 and config.surface.first_period == config.surface.last_period


def test_regularisers_stay_where_a_box_is_stated(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene()
    stated, guessed = (replace(scene, bounds_from=words) for words in ("stated", "cameras alone"))
    assert not regularisers.decided(Normalisation.of(stated), stated, load_config()).skipped
    assert regularisers.decided(Normalisation.of(guessed), guessed, load_config()).skipped
    assert not regularisers.decided(Normalisation.of(guessed), guessed, load_config("refnerf")).skipped


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
    config, skip = exposure.decided(None if log is None else gains_of(log), load_config())
    assert config.train.per_image == chosen and skip.skipped == (chosen == "none")


def test_what_a_person_sets_is_learned_whatever_was_found() -> None:
    found = gains_of([[0.0] * 3, [0.6] * 3])
    for chosen in ("none", "exposure", "colour"):
        config, skip = exposure.decided(found, load_config(overrides=[f"train.per_image={chosen}"]))
        assert config.train.per_image == chosen and skip.skipped == (chosen == "none")
