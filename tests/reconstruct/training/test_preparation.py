"""What an untrained field is told of its scene."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets.scene import Scene
from reconstruct.models import load_config
from reconstruct.scene.rays import Normalisation
from reconstruct.training.preparation import for_scene


def test_a_scene_with_surroundings_tells_how_large_its_box_is(ball_scene: tuple[Scene, Path]) -> None:
    alone = ball_scene[0]
    low, high = alone.box
    among = replace(alone, background="scene", box=np.stack([low, high - [0, 0, 0.1]]))
    config = load_config("surfnerf", "fast", ["field.matte_around=3.5"])
    found = for_scene(config, among, among.views, Normalisation.of(among)).field
    np.testing.assert_allclose(found.half_box, [2 / 3, 2 / 3, 1 / 3])  # 0.2 x 0.2 x 0.1 m has a diagonal of 0.3 m: the unit ball
    assert found.towards is not None and np.linalg.norm(found.towards) < 1
    assert for_scene(config, alone, alone.views, Normalisation.of(alone)).field.half_box is None


def test_what_the_configuration_says_of_the_scene_stands(ball_scene: tuple[Scene, Path]) -> None:
    among = replace(ball_scene[0], background="scene")
    given = load_config("surfnerf", "fast", ["field.matte_around=3.5", "field.half_box=[0.1,0.2,0.3]", "field.towards=[0,0,0.5]"])
    found = for_scene(given, among, among.views, Normalisation.of(among)).field
    assert found.half_box == (0.1, 0.2, 0.3) and found.towards == (0.0, 0.0, 0.5)
    plain = load_config("surfnerf", "fast", ["field.outward=0", "field.half_box=[0.1,0.2,0.3]", "sampler.candidates=2"])
    assert for_scene(plain, among, among.views, Normalisation.of(among)) == plain


@pytest.mark.parametrize(
    ("background", "bounds_from", "candidates"),
    [
        ("scene", "stated", 4),
        ("scene", "box stated; near from 172 points", 4),
        ("scene", "cameras alone", 1),
        ("white", "stated", None),
    ],
)
def test_rays_that_meet_the_box_are_preferred_where_it_is_stated(
    ball_scene: tuple[Scene, Path], background: str, bounds_from: str, candidates: int | None
) -> None:
    """A box that is only guessed may hold anything, and without surroundings there is nothing to prefer it to."""
    scene = replace(ball_scene[0], background=background, bounds_from=bounds_from)
    config = load_config("surfnerf", "fast")
    assert for_scene(config, scene, scene.views, Normalisation.of(scene)).sampler.candidates == candidates
