from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.decisions.evidence.matches import matches_of
from koala3d.reconstruct.training.decisions.poses import decided as decided_on
from koala3d.reconstruct.training.decisions.skip import Skip
from tests.reconstruct.training.decisions.textured import textured_wall


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return textured_wall(tmp_path_factory.mktemp("wall"))


def decided(scene: Scene, *overrides: str) -> tuple[Config, Skip]:
    config = load_config(overrides=list(overrides))
    return decided_on(config, matches_of(scene, scene.views, config), scene, Normalisation.of(scene))


def turned(scene: Scene, sigma: float) -> Scene:
    random = np.random.default_rng(0)
    turns = [pose.from_rotation_vector(random.normal(0, sigma, 3)) for _ in scene.views]
    return scene.with_views(
        tuple(replace(v, world_from_camera=v.world_from_camera @ turn) for v, turn in zip(scene.views, turns, strict=True))
    )


def test_poses_that_fit_are_kept(wall: Scene) -> None:
    config, skip = decided(wall)
    assert config.poses.enabled is False and skip.skipped and "matched points miss their features by 0." in skip.evidence
    assert config.poses.model_copy(update={"enabled": "auto"}) == load_config().poses, "nothing else has changed"


def test_poses_that_miss_are_refined_within_what_they_miss_by(wall: Scene) -> None:
    sigma = 1.5 / 170  # a pixel and a half
    config, skip = decided(turned(wall, sigma))
    assert config.poses.enabled is True and not skip.skipped and skip.name == "poses"
    assert sigma / 4 < config.poses.sigma_rad < sigma
    assert config.poses.sigma_m == pytest.approx(4 * config.poses.sigma_rad, rel=0.2)  # the wall is 4 away


@pytest.mark.parametrize(("change", "why"), [
    (lambda s: replace(s, provenance={"calibration": "calibration.json"}), "calibrated arm"),
    (lambda s: replace(s, background="white"), "an object alone"),
])  # fmt: skip
def test_poses_are_kept_where_matches_say_nothing_of_them(wall: Scene, change: Callable[[Scene], Scene], why: str) -> None:
    config, skip = decided(change(turned(wall, 1.5 / 170)))
    assert config.poses.enabled is False and why in skip.evidence


def test_what_a_person_sets_is_done(wall: Scene) -> None:
    for wanted in (True, False):
        config, skip = decided(wall, f"poses.enabled={str(wanted).lower()}")
        assert config.poses.enabled is wanted and skip.skipped is not wanted and skip.evidence == "not measured"


def test_views_are_compared_only_where_something_is_to_be_decided(wall: Scene, tmp_path: Path) -> None:
    nothing = load_config(overrides=["poses.enabled=false", "train.per_image=none", "skip.reflection=false"])
    missing = tuple(replace(view, image=tmp_path / "missing.png") for view in wall.views)
    assert matches_of(wall, missing, nothing) is None, "no picture is read"
    found = matches_of(wall, wall.views, load_config(overrides=["poses.enabled=false", "train.per_image=auto"]))
    assert found is not None and found.count > 200
